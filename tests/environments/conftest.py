"""A scene with a drawer and a block."""

import pytest

from neoworld_mjx.spec import Box, ObjectSpec, SceneObject, SceneSpec
from tests.support.mechanisms import WOOD, geom, joint, part, single


@pytest.fixture(scope="session")
def scene():
    """A chest with a drawer that has a bar to pull at, and a block on top, half a metre up."""
    body = part("body", geom("body", Box(size=(0.3, 0.4, 0.1)), (0, 0, 0.05)))
    drawer = part(
        "drawer",
        geom("front", Box(size=(0.02, 0.3, 0.1)), (0.17, 0, 0.2)),
        geom("handle", Box(size=(0.03, 0.1, 0.01)), (0.2, 0, 0.2)),
    )
    slide = joint("slide", "prismatic", "body", "drawer", (0.17, 0, 0.2), (1, 0, 0), upper=0.2,
                  damping=2.0)  # fmt: skip
    chest = ObjectSpec(name="chest", materials=(WOOD,), parts=(body, drawer), joints=(slide,))
    block = single("block", Box(size=(0.05, 0.05, 0.05)), 0.025)
    return SceneSpec(
        objects=(
            SceneObject(name="chest", spec=chest, fixed_base=True, yaw=0.5),
            SceneObject(name="block", spec=block, parent="chest", z=0.1001, xy=(-0.05, 0)),
        )
    )

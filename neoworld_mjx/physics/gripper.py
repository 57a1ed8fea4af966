"""A free parallel gripper for a scene.

Its actuators are x, y, z (displacement from its initial position in the world [m]), turn_x, turn_y,
turn_z (rotation vector in the tool's initial axes [rad]), left and right (fingers [m]).
"""

from dataclasses import dataclass
from functools import cache
from importlib import resources

import mujoco

from ..spec.pose import IDENTITY

PREFIX = "end_effector"
"""Prefix of the names of its bodies, which no object of the scene may have as its name."""
OPENING_M = 0.12
"""Largest distance of the pads [m]."""
CLOSED_M = -0.02
"""Target of a closed finger, beyond contact, so that it exerts its full force [m]."""


@dataclass(frozen=True)
class Gripper:
    """Initial state of a gripper; its tool frame has +z out of the palm, fingers close along y."""

    pos: tuple[float, float, float]
    """[m]"""
    quat: tuple[float, float, float, float] = IDENTITY
    opening: float = OPENING_M
    """Distance of the pads [m]."""


def attach_gripper(
    model: mujoco.MjSpec, gripper: Gripper, *, mjx: bool = False, group: int | None = None
) -> None:
    """Add a gripper to a specification; its coordinates follow the existing ones.

    Args:
        model: the specification.
        gripper: its initial state.
        mjx: True sets condim 3 and priority 0 on its geoms, as `mjx_step` requires.
        group: of its geoms; None keeps those of the file.
    """
    hand = mujoco.MjSpec.from_string(_text())
    hand.body("hand").quat = gripper.quat
    for geom in hand.geoms:
        if mjx:
            geom.condim, geom.priority = 3, 0
        if group is not None:
            geom.group = group
    frame = model.worldbody.add_frame(pos=gripper.pos)
    model.attach(hand, prefix=f"{PREFIX}-", frame=frame)


@cache
def _text() -> str:
    return resources.files("neoworld_mjx.physics").joinpath("gripper.xml").read_text("utf-8")

"""A free parallel gripper beside a scene.

Its actuators are x, y, z (displacement from its start in the world [m]), turn_x, turn_y, turn_z
(rotation vector from its start, in the tool's axes there [rad]), left and right (fingers [m]).
"""

from dataclasses import dataclass
from functools import cache
from importlib import resources

import mujoco

from ..spec.pose import IDENTITY

PREFIX = "end_effector"
"""Name that no object of a scene with a gripper may have; those of its bodies begin with it."""
OPENING_M = 0.12
"""Largest distance of the pads [m]."""
CLOSED_M = -0.02
"""Target of a finger that asks for more than closed, so for all its force [m]."""


@dataclass(frozen=True)
class Gripper:
    """Where a gripper starts: its tool frame, +z out of the palm, fingers closing along y."""

    pos: tuple[float, float, float]
    """[m]"""
    quat: tuple[float, float, float, float] = IDENTITY
    opening: float = OPENING_M
    """Distance of the pads [m]."""


def attach_gripper(
    model: mujoco.MjSpec, gripper: Gripper, *, mjx: bool = False, group: int | None = None
) -> None:
    """Add a gripper to a specification; its coordinates come after those that are there.

    Args:
        model: the specification.
        gripper: where it starts.
        mjx: whether its pads are such as `mjx_step` collides: of condim 3, without priority.
        group: of its geoms; None leaves those of its file.
    """
    own = mujoco.MjSpec.from_string(_text())
    own.body("hand").quat = gripper.quat
    for geom in own.geoms:
        if mjx:
            geom.condim, geom.priority = 3, 0
        if group is not None:
            geom.group = group
    frame = model.worldbody.add_frame(pos=gripper.pos)
    model.attach(own, prefix=f"{PREFIX}-", frame=frame)


@cache
def _text() -> str:
    return resources.files("neoworld_mjx.physics").joinpath("gripper.xml").read_text("utf-8")

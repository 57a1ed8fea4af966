"""A parallel gripper that moves freely in a scene.

The gripper has these position actuators:

- x, y, z: displacement from the initial position, in the world frame [m];
- turn_x, turn_y, turn_z: rotation vector in the initial tool frame [rad];
- left, right: positions of the fingers [m].
"""

from dataclasses import dataclass
from functools import cache
from importlib import resources

import mujoco

from ..spec.pose import IDENTITY

PREFIX = "end_effector"
"""Prefix of the names of the gripper's bodies. No object of the scene may have this name."""
OPENING_M = 0.12
"""Largest distance between the pads [m]."""
CLOSED_M = -0.02
"""Target position of a closed finger [m]. It is beyond contact, so that the finger exerts its full
force."""


@dataclass(frozen=True)
class Gripper:
    """Initial pose and opening of a gripper.

    The tool frame's +z axis points out of the palm; the fingers close along y.
    """

    pos: tuple[float, float, float]
    """[m]"""
    quat: tuple[float, float, float, float] = IDENTITY
    opening: float = OPENING_M
    """Distance between the pads [m]."""


def attach_gripper(
    model: mujoco.MjSpec, gripper: Gripper, *, mjx: bool = False, group: int | None = None
) -> None:
    """Add a gripper to a model specification. Its coordinates follow the existing coordinates.

    Args:
        model: the specification.
        gripper: the gripper's initial state.
        mjx: if True, set condim 3 and priority 0 on the gripper's geoms, as `mjx_step` requires.
        group: group of the gripper's geoms; if None, keep the groups of the gripper's file.
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

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
"""Prefix of the names of the gripper's bodies; no object of the scene may have this name."""
OPENING_M = 0.12
"""Largest distance of the pads [m]."""
CLOSED_M = -0.02
"""Target of a closed finger, beyond contact, so that it exerts its full force [m]."""


@dataclass(frozen=True)
class Gripper:
    """Initial pose and opening of a gripper.

    The tool frame's +z axis points out of the palm; the fingers close along y.
    """

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
        gripper: the gripper's initial state.
        mjx: True sets condim 3 and priority 0 on the gripper's geoms, as `mjx_step` requires.
        group: group of the gripper's geoms; None keeps the groups in its file.
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

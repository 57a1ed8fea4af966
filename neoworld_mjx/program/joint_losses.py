"""Default damping and dry friction of joints, from the mass that they carry."""

import math

import numpy as np

from ..spec import Inertial, JointSpec
from ..spec.pose import conjugate, rotate

GRAVITY = 9.81
SETTLING_S = 0.4
"""Time constant with which a joint loses its speed."""
TURNING_FRICTION, SLIDING_FRICTION = 0.02, 0.1
"""Dry friction over weight times lever, and over weight."""


def default_losses(joint: JointSpec, child: Inertial) -> tuple[float, float]:
    """Return damping and dry friction for a joint that moves: N s/m and N, or N m s/rad and N m.

    Args:
        joint: the joint, not fixed.
        child: mass and inertia of the part that it carries.
    """
    if joint.type == "prismatic":
        return child.mass / SETTLING_S, SLIDING_FRICTION * child.mass * GRAVITY
    arm = np.array(child.pos) - np.array(joint.pos)
    if joint.type == "ball":
        own = max(child.diagonal)  # It turns about any axis: take the slowest.
    else:
        axis = np.array(joint.axis)
        arm = arm - (arm @ axis) * axis
        own = rotate(conjugate(child.quat), axis) ** 2 @ np.array(child.diagonal)
    inertia = float(own) + child.mass * float(arm @ arm)
    # The radius of gyration is the lever, so that a balanced knob holds still too.
    lever = math.sqrt(inertia / child.mass)
    return inertia / SETTLING_S, TURNING_FRICTION * child.mass * GRAVITY * lever

"""Default damping and dry friction of joints, from the mass that they carry."""

import math

from ..spec import Inertial, JointSpec
from ..spec.mass import inertia_about

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
    inertia = inertia_about(joint, child)
    if joint.type == "prismatic":
        return inertia / SETTLING_S, SLIDING_FRICTION * child.mass * GRAVITY
    # The radius of gyration is the lever, so that a balanced knob holds still too.
    lever = math.sqrt(inertia / child.mass)
    return inertia / SETTLING_S, TURNING_FRICTION * child.mass * GRAVITY * lever

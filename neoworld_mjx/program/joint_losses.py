"""Default damping and dry friction of joints, from the mass of the child part."""

import math

from ..spec import Inertial, JointSpec
from ..spec.mass import inertia_about

GRAVITY = 9.81
SETTLING_S = 0.4
"""Time constant [s] with which damping slows down a joint."""
TURNING_FRICTION, SLIDING_FRICTION = 0.02, 0.1
"""Dry friction of turning joints, over weight times moment arm; of sliding joints, over weight."""


def default_losses(joint: JointSpec, child: Inertial) -> tuple[float, float]:
    """Return the default damping and dry friction of a joint that is not fixed.

    Units are N s/m and N for a prismatic joint, and N m s/rad and N m for other joints.

    Args:
        joint: the joint.
        child: mass and inertia of the part that the joint moves.
    """
    inertia = inertia_about(joint, child)
    if joint.type == "prismatic":
        return inertia / SETTLING_S, SLIDING_FRICTION * child.mass * GRAVITY
    # The moment arm is the radius of gyration, so that a balanced knob has friction, too.
    arm = math.sqrt(inertia / child.mass)
    return inertia / SETTLING_S, TURNING_FRICTION * child.mass * GRAVITY * arm

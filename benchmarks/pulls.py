"""Force on a handle that opens the same joint in every simulator."""

from typing import NamedTuple

import numpy as np

from neoworld_mjx.export.link_frames import frames
from neoworld_mjx.spec import JointSpec, ObjectSpec, inertial
from neoworld_mjx.spec.kinematics import moving_parts
from neoworld_mjx.spec.pose import matrix

PULL_S = 0.5
"""Duration of a pull."""
ACCELERATION, TURNING_ACCELERATION = 0.8, 2.5
"""Accelerations of pulled parts [m/s^2, rad/s^2]: 10 cm or 18 degrees in all, or half of the
joint's range if that is less, so that no stop is hit. Friction, damping and weight are added.
"""
GRAVITY = 9.81
LEAST_ARM_M = 0.02
"""Handles closer to their axis than this get no pull."""


class Pull(NamedTuple):
    """A force on a handle, with the fields of motion_probe's options."""

    joint: str
    link: str
    offset: list[float]
    """Point of action in the link's frame [m]."""
    force: list[float]
    """Force in the world frame, constant in direction [N]."""


def pull_of(spec: ObjectSpec, *, dry: bool = True) -> Pull | None:
    """Return the pull that opens an object's first drawer, else its first door or lid.

    Args:
        spec: the object.
        dry: True if joints have dry friction, which the pull then overcomes.
    """
    for kind in ("prismatic", "revolute"):
        for joint in spec.joints:
            if joint.type == kind and joint.mimic is None and joint.upper - joint.lower > 0.02:
                pull = _pull(spec, joint, dry)
                if pull is not None:
                    return pull
    return None


def _pull(spec: ObjectSpec, joint: JointSpec, dry: bool) -> Pull | None:
    point = next((np.array(f.pos) for f in frames(spec) if f.joint == joint.name), None)
    if point is None:
        return None
    offset, axis = point - np.array(joint.pos), np.array(joint.axis)
    direction = axis
    if joint.type == "revolute":
        direction = np.cross(axis, offset)
        if np.linalg.norm(direction) < LEAST_ARM_M:
            return None
        # A force of 1 / arm has unit torque.
        direction = direction / float(direction @ direction)
    opening = 1.0 if joint.upper >= -joint.lower else -1.0
    most = ACCELERATION if joint.type == "prismatic" else TURNING_ACCELERATION
    acceleration = min(most, max(joint.upper, -joint.lower) / PULL_S**2)
    inertia, weight = _load(spec, joint)
    # Damping at the mean velocity.
    effort = (inertia + joint.damping * PULL_S / 2) * acceleration + max(opening * weight, 0.0)
    effort += joint.friction if dry else 0.0
    return Pull(joint.name, joint.child, offset.tolist(), (opening * effort * direction).tolist())


def _load(spec: ObjectSpec, joint: JointSpec) -> tuple[float, float]:
    """Return a joint's inertia [kg, kg m^2] and its effort against weight at rest [N, N m]."""
    axis, inertia, weight = np.array(joint.axis), 0.0, 0.0
    for body in (inertial(spec, spec.part(name)) for name in moving_parts(spec, joint)):
        if joint.type == "prismatic":
            inertia += body.mass
            weight += body.mass * GRAVITY * axis[2]
        else:
            arm = np.cross(axis, np.array(body.pos) - joint.pos)
            principal = matrix(body.quat).T @ axis
            inertia += body.mass * float(arm @ arm) + float(np.square(principal) @ body.diagonal)
            weight += body.mass * GRAVITY * arm[2]
    return inertia, float(weight)

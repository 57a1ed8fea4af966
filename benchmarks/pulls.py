"""The pull of an object's handle that the same joint gets in every simulator."""

from typing import NamedTuple

import numpy as np

from neoworld_mjx.export.handles import frames
from neoworld_mjx.spec import JointSpec, ObjectSpec, inertial
from neoworld_mjx.spec.kinematics import moving_parts
from neoworld_mjx.spec.pose import matrix

PULL_S = 0.5
"""How long a pull lasts."""
ACCELERATION, TURNING_ACCELERATION = 0.8, 2.5
"""Of what a pull moves [m/s^2, rad/s^2]: 10 cm or 18 degrees, less where that is over half of the
joint's way, so that no stop is hit. Friction, damping and weight come on top.
"""
GRAVITY = 9.81
LEAST_ARM_M = 0.02
"""Handles nearer than this to their axis are not pulled but turned."""


class Pull(NamedTuple):
    """A force that acts at a handle, as motion_probe takes it."""

    joint: str
    link: str
    offset: list[float]
    """From the link's frame [m]."""
    force: list[float]
    """Of the world [N]; it keeps its direction."""


def pull_of(spec: ObjectSpec, *, dry: bool = True) -> Pull | None:
    """Return the pull that opens an object's first drawer, else its first door or lid.

    Args:
        spec: the object.
        dry: whether joints have their dry friction, which the pull then overcomes.
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
    way = axis
    if joint.type == "revolute":
        way = np.cross(axis, offset)
        if np.linalg.norm(way) < LEAST_ARM_M:
            return None
        # A force of 1 / arm has a torque of 1.
        way = way / float(way @ way)
    opening = 1.0 if joint.upper >= -joint.lower else -1.0
    most = ACCELERATION if joint.type == "prismatic" else TURNING_ACCELERATION
    acceleration = min(most, max(joint.upper, -joint.lower) / PULL_S**2)
    inertia, weight = _load(spec, joint)
    # With its mean velocity what is damped strongly gets as far as what is not.
    effort = (inertia + joint.damping * PULL_S / 2) * acceleration + max(opening * weight, 0.0)
    effort += joint.friction if dry else 0.0
    return Pull(joint.name, joint.child, offset.tolist(), (opening * effort * way).tolist())


def _load(spec: ObjectSpec, joint: JointSpec) -> tuple[float, float]:
    """Return what a joint moves, and the effort [N, N m] that its weight takes at the start.

    What it moves is a mass [kg], or a moment [kg m^2] about the joint's axis.
    """
    axis, inertia, weight = np.array(joint.axis), 0.0, 0.0
    for own in (inertial(spec, spec.part(name)) for name in moving_parts(spec, joint)):
        if joint.type == "prismatic":
            inertia += own.mass
            weight += own.mass * GRAVITY * axis[2]
        else:
            arm = np.cross(axis, np.array(own.pos) - joint.pos)
            principal = matrix(own.quat).T @ axis
            inertia += own.mass * float(arm @ arm) + float(np.square(principal) @ own.diagonal)
            weight += own.mass * GRAVITY * arm[2]
    return inertia, float(weight)

"""The pull of an object's handle that the same joint gets in every simulator."""

from typing import NamedTuple

import numpy as np

from neoworld_mjx.export.handles import frames
from neoworld_mjx.spec import JointSpec, ObjectSpec, inertial
from neoworld_mjx.spec.kinematics import carried

ACCELERATION = 0.8
"""Of what a pull moves [m/s^2]: its force is this times the mass, and what dry friction takes."""
TURNING_ARM_M = 0.3
"""Arm at which such a force turns a door or lid."""
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


def pull_of(spec: ObjectSpec) -> Pull | None:
    """Return the pull that opens an object's first drawer, else its first door or lid."""
    for kind in ("prismatic", "revolute"):
        for joint in spec.joints:
            if joint.type == kind and joint.mimic is None and joint.upper - joint.lower > 0.02:
                pull = _pull(spec, joint)
                if pull is not None:
                    return pull
    return None


def _pull(spec: ObjectSpec, joint: JointSpec) -> Pull | None:
    point = next((np.array(f.pos) for f in frames(spec) if f.joint == joint.name), None)
    if point is None:
        return None
    offset, axis = point - np.array(joint.pos), np.array(joint.axis)
    mass = sum(inertial(spec, spec.part(name)).mass for name in carried(spec, joint))
    if joint.type == "prismatic":
        way, strength = axis, joint.friction + ACCELERATION * mass
    else:
        way = np.cross(axis, offset)
        arm = float(np.linalg.norm(way))
        if arm < LEAST_ARM_M:
            return None
        way, torque = way / arm, joint.friction + ACCELERATION * mass * TURNING_ARM_M
        strength = torque / arm
    opening = 1.0 if joint.upper >= -joint.lower else -1.0
    force = opening * strength * way
    return Pull(joint.name, joint.child, offset.tolist(), force.tolist())

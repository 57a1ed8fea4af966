"""Kinematics of an object: joint positions, link poses, and parts that move together."""

from collections.abc import Mapping

import numpy as np

from .base import Vec3
from .joint import JointSpec
from .object import ObjectSpec
from .pose import Pose, from_axis_angle, pose, rotate

_AT_REST = pose()


def link_poses(spec: ObjectSpec, joint_state: Mapping[str, float]) -> dict[str, Pose]:
    """Return the displacement of each part from its pose with all joints at zero.

    Displacements are transforms in the object's frame.

    Args:
        spec: the object.
        joint_state: joint values [rad or m]. Joints that are not listed are at 0; a mimic joint
            follows its leader.
    """
    values = {joint.name: joint_position(spec, joint, joint_state) for joint in spec.joints}
    poses: dict[str, Pose] = {}
    for part, joint in spec.ordered:
        if joint is None:
            poses[part.name] = pose()
            continue
        motion = joint_motion(joint, values[joint.name])
        above = poses[joint.parent]
        poses[part.name] = above if motion is _AT_REST else above.then(motion)
    return poses


def joint_value(spec: ObjectSpec, joint: JointSpec, joint_state: Mapping[str, float]) -> float:
    """Return the position of a joint [rad or m]; a mimic joint follows its leader."""
    visited = set()
    factor, offset = 1.0, 0.0
    while joint.mimic is not None and joint.name not in visited:
        visited.add(joint.name)
        offset += factor * joint.mimic.offset
        factor *= joint.mimic.multiplier
        joint = spec.joint(joint.mimic.joint)
    return factor * joint_state.get(joint.name, 0.0) + offset


def ball_vector(joint: JointSpec, joint_state: Mapping[str, float]) -> Vec3:
    """Return the rotation vector [rad] of a ball joint."""
    x, y, z = (joint_state.get(f"{joint.name}.{axis}", 0.0) for axis in "xyz")
    return x, y, z


def joint_keys(joint: JointSpec) -> tuple[str, ...]:
    """Return a joint's keys in a joint state: NAME or, for a ball, NAME.x, NAME.y and NAME.z."""
    if joint.type == "ball":
        return tuple(f"{joint.name}.{axis}" for axis in "xyz")
    return (joint.name,)


def joint_position(
    spec: ObjectSpec, joint: JointSpec, joint_state: Mapping[str, float]
) -> float | Vec3:
    """Return the position of a joint [rad or m]: one value or, for a ball, a rotation vector.

    A mimic joint follows its leader.
    """
    if joint.type == "ball":
        return ball_vector(joint, joint_state)
    return joint_value(spec, joint, joint_state)


def joint_motion(joint: JointSpec, value: float | Vec3) -> Pose:
    """Return the displacement of a joint's child at joint position `value`, in the object's frame.

    Other joints are at zero.
    """
    if isinstance(value, tuple):
        angle = float(np.linalg.norm(value))
        turn = from_axis_angle(value, angle) if angle > 0.0 else None
    elif joint.type == "prismatic":
        return pose(np.array(joint.axis) * value)
    else:
        moves = joint.type != "fixed" and value != 0.0
        turn = from_axis_angle(joint.axis, value) if moves else None
    if turn is None:
        return _AT_REST
    anchor = np.array(joint.pos)
    return pose(anchor - rotate(turn, anchor), turn)


def welded(spec: ObjectSpec) -> dict[str, str]:
    """Map each part to the root of the group of parts to which fixed joints connect it."""
    group: dict[str, str] = {}
    for part, joint in spec.ordered:
        rigid = joint is not None and joint.type == "fixed"
        group[part.name] = group[joint.parent] if rigid and joint is not None else part.name
    return group


def followers(spec: ObjectSpec, joint: JointSpec) -> set[str]:
    """Return the names of the joints that mimic a joint, directly or through other joints."""
    leaders = {joint.name}
    for _ in spec.joints:
        leaders |= {j.name for j in spec.joints if j.mimic is not None and j.mimic.joint in leaders}
    return leaders - {joint.name}


def moving_parts(spec: ObjectSpec, joint: JointSpec) -> set[str]:
    """Return the names of the parts that move with a joint and its followers."""
    moving_joints = {joint.name} | followers(spec, joint)
    moving: set[str] = set()
    for part, own_joint in spec.ordered:
        if own_joint and (own_joint.name in moving_joints or own_joint.parent in moving):
            moving.add(part.name)
    return moving


def with_joint(spec: ObjectSpec, joint: JointSpec) -> ObjectSpec:
    """Return the object with the joint of the same name replaced by `joint`."""
    joints = tuple(joint if j.name == joint.name else j for j in spec.joints)
    return spec.model_copy(update={"joints": joints})

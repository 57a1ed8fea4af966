"""Kinematics of an object: positions of joints and links, and parts that move together."""

from collections.abc import Mapping

import numpy as np

from .base import Vec3
from .joint import JointSpec
from .object import ObjectSpec
from .pose import Pose, from_axis_angle, pose, rotate

_AT_REST = pose()


def link_poses(spec: ObjectSpec, joint_state: Mapping[str, float]) -> dict[str, Pose]:
    """Return the displacement of each part from rest at `joint_state` [rad or m].

    Joints not named are at 0; a mimic joint follows its leader. Displacements are transforms in the
    object's frame.
    """
    values = {joint.name: joint_position(spec, joint, joint_state) for joint in spec.joints}
    moved: dict[str, Pose] = {}
    for part, joint in spec.ordered:
        if joint is None:
            moved[part.name] = pose()
            continue
        motion = joint_motion(joint, values[joint.name])
        above = moved[joint.parent]
        moved[part.name] = above if motion is _AT_REST else above.then(motion)
    return moved


def joint_value(spec: ObjectSpec, joint: JointSpec, joint_state: Mapping[str, float]) -> float:
    """Return the position of a joint, following mimics [rad or m]."""
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
    """Return a joint's keys in a joint state: NAME; of a ball joint NAME.x, NAME.y and NAME.z."""
    if joint.type == "ball":
        return tuple(f"{joint.name}.{axis}" for axis in "xyz")
    return (joint.name,)


def joint_position(
    spec: ObjectSpec, joint: JointSpec, joint_state: Mapping[str, float]
) -> float | Vec3:
    """Return the position of a joint, following mimics: one value, or a ball's rotation vector."""
    if joint.type == "ball":
        return ball_vector(joint, joint_state)
    return joint_value(spec, joint, joint_state)


def joint_motion(joint: JointSpec, value: float | Vec3) -> Pose:
    """Return the displacement of the child by a joint at `value`, in the object's rest frame."""
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
    """Map each part to the root of its group of parts connected by fixed joints."""
    group: dict[str, str] = {}
    for part, joint in spec.ordered:
        rigid = joint is not None and joint.type == "fixed"
        group[part.name] = group[joint.parent] if rigid and joint is not None else part.name
    return group


def followers(spec: ObjectSpec, joint: JointSpec) -> set[str]:
    """Return the names of the joints that follow a joint (mimic), directly or not."""
    leaders = {joint.name}
    for _ in spec.joints:
        leaders |= {j.name for j in spec.joints if j.mimic is not None and j.mimic.joint in leaders}
    return leaders - {joint.name}


def moving_parts(spec: ObjectSpec, joint: JointSpec) -> set[str]:
    """Return the names of the parts that move with a joint and its followers."""
    moving_joints = {joint.name} | followers(spec, joint)
    moved: set[str] = set()
    for part, own_joint in spec.ordered:
        if own_joint and (own_joint.name in moving_joints or own_joint.parent in moved):
            moved.add(part.name)
    return moved


def with_joint(spec: ObjectSpec, joint: JointSpec) -> ObjectSpec:
    """Return the object with the joint of the same name replaced."""
    joints = tuple(joint if j.name == joint.name else j for j in spec.joints)
    return spec.model_copy(update={"joints": joints})

"""Kinematics of an object: joint positions, link poses, parts that move together, and bounds."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .base import Quat, Vec3
from .convex import Piece, box_around
from .joint import JointSpec
from .object import GeomSpec, ObjectSpec, PartSpec, Role
from .pose import IDENTITY, Pose, from_axis_angle, pose, rotate

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


def pieces(part: PartSpec, role: Role = "collision") -> list[tuple[GeomSpec, Piece, Pose]]:
    """Return the convex pieces of a part's geoms with the given role or the role "both".

    Returns:
        The geom, the piece, and the pose of the piece in the object's frame, for each piece.
    """
    return list(_placed_pieces(part, role))  # pyright: ignore[reportArgumentType] it has a hash


@lru_cache(maxsize=512)
def _placed_pieces(part: PartSpec, role: Role) -> tuple[tuple[GeomSpec, Piece, Pose], ...]:
    posed_pieces = []
    for geom in part.geoms:
        if geom.role in (role, "both"):
            for piece in geom.shape.pieces():
                posed_pieces.append((geom, piece, geom.pose().then(pose(piece.pos, piece.quat))))
    return tuple(posed_pieces)


def bounds(
    spec: ObjectSpec,
    joint_state: dict[str, float] | None = None,
    tilt: Quat = IDENTITY,
) -> tuple[NDArray, NDArray]:
    """Return the exact axis-aligned bounds (low [3], high [3]) [m] of an object's colliders.

    Args:
        spec: the object.
        joint_state: joint values [rad or m]; all joints are at zero by default.
        tilt: rotation of the whole object about its origin.
    """
    part_poses = link_poses(spec, joint_state or {})
    base = pose((0, 0, 0), tilt)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for part in spec.parts:
        for _, piece, piece_pose in pieces(part):
            lower, upper = box_around(piece, base.then(part_poses[part.name]).then(piece_pose))
            low, high = np.minimum(low, lower), np.maximum(high, upper)
    return low, high


def translated(spec: ObjectSpec, offset: NDArray) -> ObjectSpec:
    """Return the object with all positions shifted by `offset` [m], shape [3]."""

    def move(point: Vec3) -> Vec3:
        return tuple((np.array(point) + offset).tolist())

    return spec.model_copy(
        update={
            "parts": tuple(
                part.model_copy(
                    update={
                        "geoms": tuple(
                            geom.model_copy(update={"pos": move(geom.pos)}) for geom in part.geoms
                        ),
                        "inertia": part.inertia
                        and part.inertia.model_copy(update={"pos": move(part.inertia.pos)}),
                    }
                )
                for part in spec.parts
            ),
            "joints": tuple(j.model_copy(update={"pos": move(j.pos)}) for j in spec.joints),
            "sites": tuple(s.model_copy(update={"pos": move(s.pos)}) for s in spec.sites),
        }
    )


def recentred(spec: ObjectSpec) -> ObjectSpec:
    """Return the object with its origin at the center of the bounding box's bottom face."""
    low, high = bounds(spec)
    return translated(spec, -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]))


def part_bounds(spec: ObjectSpec, part: PartSpec) -> tuple[NDArray, NDArray]:
    """Return the bounds (low [3], high [3]) [m] of a part's colliders with all joints at zero."""
    return bounds(spec.model_copy(update={"parts": (part,), "joints": (), "sites": ()}))

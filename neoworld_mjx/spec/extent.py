"""Convex pieces of parts, and bounds of objects at given joint states."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .base import Quat, Vec3
from .convex import Piece, box_around
from .kinematics import link_poses
from .object import GeomSpec, ObjectSpec, PartSpec, Role
from .pose import IDENTITY, Pose, pose


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
    role: Role = "collision",
) -> tuple[NDArray, NDArray]:
    """Return the exact axis-aligned bounds (low [3], high [3]) [m] of an object.

    Args:
        spec: the object.
        joint_state: joint values [rad or m]; all joints are at zero by default.
        tilt: rotation of the whole object about its origin.
        role: role of the geoms that count, "collision" or "visual".
    """
    part_poses = link_poses(spec, joint_state or {})
    base = pose((0, 0, 0), tilt)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for part in spec.parts:
        for _, piece, piece_pose in pieces(part, role):
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

"""Convex pieces: hulls, half-spaces, mass properties and extents.

A piece becomes one collision geom of MuJoCo. `size` follows MuJoCo's geom_size: half edge lengths
of a box, (radius, half length) of a capsule or cylinder, semi-axes of an ellipsoid.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .pose import IDENTITY, Pose, cross, matrix

Kind = Literal["box", "sphere", "capsule", "cylinder", "ellipsoid", "mesh"]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Piece:
    """A convex solid, and its pose in the frame of the shape."""

    kind: Kind
    size: tuple[float, ...] = (0.0, 0.0, 0.0)
    pos: Vector = (0.0, 0.0, 0.0)
    quat: tuple[float, float, float, float] = IDENTITY
    vertices: tuple[Vector, ...] = ()
    """Corners of a "mesh" piece [m]; empty for all other kinds."""


def polytope(points: NDArray) -> Piece:
    """Return the convex hull of points [n, 3] as a "mesh" piece, without inner points."""
    # Equivalent to np.unique along rows, in a tenth of the time.
    vertices, _ = hull(tuple(sorted(set(map(tuple, np.asarray(points, float).tolist())))))
    return Piece("mesh", vertices=tuple(map(tuple, vertices.tolist())))


def prism(outline: NDArray, height: float) -> Piece:
    """Return the prism of a convex outline [n, 2] from z = -height/2 to z = height/2."""
    top = np.column_stack([outline, np.full(len(outline), height / 2)])
    return polytope(np.vstack([top, top * [1, 1, -1]]))


@lru_cache(maxsize=2048)
def hull(points: tuple[Vector, ...]) -> tuple[NDArray, NDArray]:
    """Return the vertices [v, 3] and outward triangles [f, 3] of a convex hull.

    Raises:
        ValueError: there are fewer than four points, or the points lie in a plane.
    """
    from scipy.spatial import ConvexHull, QhullError

    p = np.array(points)
    span = np.ptp(p, axis=0).max() if len(p) else 0.0
    if len(p) < 4 or span <= 0:
        raise ValueError(f"a convex piece needs 4 points in general position, got {len(p)}")
    try:
        # At unit size, the absolute tolerances of qhull act as relative ones.
        qhull = ConvexHull((p - p.mean(axis=0)) / span)
    except QhullError:
        raise ValueError("a convex piece is flat") from None
    used = np.sort(qhull.vertices)
    index = np.full(len(p), -1)
    index[used] = np.arange(len(used))
    faces = index[qhull.simplices]
    v = p[used]
    normal = cross(v[faces[:, 1]] - v[faces[:, 0]], v[faces[:, 2]] - v[faces[:, 0]])
    flip = np.sum(normal * qhull.equations[:, :3], axis=1) < 0
    faces[flip] = faces[flip][:, ::-1]
    return v, faces


def volume_of_hull(points: NDArray) -> float:
    """Return the volume [m^3] of the convex hull of points [n, 3]; 0 if they are flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0


def planes(piece: Piece) -> NDArray:
    """Return the half-spaces n.x <= d of a "box" or "mesh" piece as rows (n, d), shape [f, 4].

    Normals point outwards. Coplanar triangles of a hull give one row, so a box has six rows.
    """
    if piece.kind == "box":
        n = np.vstack([np.eye(3), -np.eye(3)])
        return np.column_stack([n, np.tile(piece.size, 2)])
    return _hull_planes(piece.vertices)


@lru_cache(maxsize=2048)
def _hull_planes(points: tuple[Vector, ...]) -> NDArray:
    """Return the half-spaces of a convex hull as a read-only array [f, 4]."""
    v, faces = hull(points)
    n = cross(v[faces[:, 1]] - v[faces[:, 0]], v[faces[:, 2]] - v[faces[:, 0]])
    area = np.linalg.norm(n, axis=1)
    n, first = n / area[:, None], v[faces[:, 0]]
    keep: list[int] = []
    distinct = np.zeros_like(n)
    for i in np.argsort(-area, kind="stable"):
        if not np.any(distinct[: len(keep)] @ n[i] >= 1 - 1e-9):
            distinct[len(keep)] = n[i]
            keep.append(int(i))
    keep.sort()
    n = n[keep]
    # Offsets are maxima over all corners, so that rounding leaves no corner outside.
    half = np.column_stack([n, (v @ n.T).max(axis=0)]) if len(first) else np.zeros((0, 4))
    half.flags.writeable = False
    return half


def mass_properties(piece: Piece) -> tuple[float, NDArray, NDArray]:
    """Return the volume, center of mass and inertia of a piece at density 1.

    Returns:
        The volume [m^3], the center of mass in the shape's frame [m], shape [3], and the inertia
        about the center of mass along the axes of the shape's frame [m^5], shape [3, 3].
    """
    s = np.array(piece.size)
    if piece.kind == "box":
        volume = 8 * s.prod()
        d = volume / 3 * (s**2)
        inertia = np.diag([d[1] + d[2], d[0] + d[2], d[0] + d[1]])
    elif piece.kind in ("sphere", "ellipsoid"):
        r = np.full(3, s[0]) if piece.kind == "sphere" else s
        volume = 4 / 3 * np.pi * r.prod()
        d = volume / 5 * r**2
        inertia = np.diag([d[1] + d[2], d[0] + d[2], d[0] + d[1]])
    elif piece.kind == "cylinder":
        r, h = s[0], 2 * s[1]
        volume = np.pi * r**2 * h
        side = volume * (3 * r**2 + h**2) / 12
        inertia = np.diag([side, side, volume * r**2 / 2])
    elif piece.kind == "capsule":
        r, h = s[0], 2 * s[1]
        tube, ball = np.pi * r**2 * h, 4 / 3 * np.pi * r**3
        volume = tube + ball
        side = tube * (3 * r**2 + h**2) / 12 + ball * (2 / 5 * r**2 + h**2 / 4 + 3 / 8 * h * r)
        inertia = np.diag([side, side, tube * r**2 / 2 + ball * 2 / 5 * r**2])
    else:
        return _mesh_properties(piece)
    rotation = matrix(piece.quat)
    return float(volume), np.array(piece.pos), rotation @ inertia @ rotation.T


def _mesh_properties(piece: Piece) -> tuple[float, NDArray, NDArray]:
    v, faces = hull(piece.vertices)
    centre = v.mean(axis=0)
    a, b, c = (v[faces[:, k]] - centre for k in range(3))
    det = np.sum(a * cross(b, c), axis=1)  # six times each tetrahedron's volume
    volume = det.sum() / 6
    com = (det[:, None] * (a + b + c)).sum(axis=0) / 24 / volume
    total = a + b + c
    second = sum(np.einsum("f,fi,fj->ij", det, p, p) for p in (a, b, c, total)) / 120
    second = second - volume * np.outer(com, com)
    inertia = np.trace(second) * np.eye(3) - second
    rotation = matrix(piece.quat)
    return (
        float(volume),
        rotation @ (centre + com) + np.array(piece.pos),
        rotation @ inertia @ rotation.T,
    )


def extent(piece: Piece, direction: NDArray) -> float:
    """Return the support max(x . direction) of a piece along a unit vector in the piece's frame."""
    s, d = np.array(piece.size), np.asarray(direction, float)
    if piece.kind == "box":
        return float(np.abs(d) @ s)
    if piece.kind == "sphere":
        return float(s[0])
    if piece.kind == "capsule":
        return float(abs(d[2]) * s[1] + s[0])
    if piece.kind == "cylinder":
        return float(abs(d[2]) * s[1] + s[0] * np.hypot(d[0], d[1]))
    if piece.kind == "ellipsoid":
        return float(np.linalg.norm(s * d))
    return float((np.array(piece.vertices) @ d).max())


@lru_cache(maxsize=64)
def sphere_directions(count: int) -> NDArray:
    """Return evenly spread unit vectors, shape [count, 3]."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])


def support_points(piece: Piece, directions: NDArray) -> NDArray:
    """Return the point of a piece that is farthest along each unit vector, in the piece's frame.

    Args:
        piece: the piece.
        directions: unit vectors, shape [n, 3].

    Returns:
        Points [m], shape [n, 3].
    """
    d, s = directions, np.array(piece.size)
    if piece.kind == "mesh":
        vertices = np.array(piece.vertices)
        return vertices[np.argmax(d @ vertices.T, axis=1)]
    if piece.kind == "box":
        return np.where(d >= 0, s, -s)
    if piece.kind == "sphere":
        return d * s[0]
    if piece.kind == "ellipsoid":
        return d * s**2 / np.linalg.norm(d * s, axis=1, keepdims=True)
    ends = np.where(d[:, 2:] >= 0, s[1], -s[1]) * [0.0, 0.0, 1.0]
    if piece.kind == "capsule":
        return ends + d * s[0]
    flat = d * [1.0, 1.0, 0.0]
    return ends + flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12) * s[0]


def box_around(piece: Piece, pose: Pose) -> tuple[NDArray, NDArray]:
    """Return the exact bounds (low [3], high [3]) [m] of a piece at a given total pose."""
    turn = matrix(pose.quat)
    if piece.kind == "mesh":
        points = np.array(piece.vertices) @ turn.T
        return pose.pos + points.min(axis=0), pose.pos + points.max(axis=0)
    # All other kinds are symmetric about their center, so one support per axis suffices.
    half = np.array([extent(piece, row) for row in turn])
    return pose.pos - half, pose.pos + half

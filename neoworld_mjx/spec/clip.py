"""Convex polyhedra, and cuts of polyhedra by planes, for exact convex decompositions."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .convex import Piece, planes
from .pose import Pose


class Poly(NamedTuple):
    """A convex polyhedron."""

    corners: NDArray
    """Vertices [m], shape [v, 3]."""
    faces: tuple[tuple[int, ...], ...]
    """Indices of the corners around each face, in either orientation."""

    def volume(self) -> float:
        """Return the volume [m^3]."""
        middle = self.corners.mean(axis=0)
        total = 0.0
        for face in self.faces:
            p = self.corners[list(face)] - middle
            fan = np.cross(p[1:-1] - p[0], p[2:] - p[0]).sum(axis=0)
            total += abs(float(fan @ p[0]))
        return total / 6


def poly(piece: Piece, pose: Pose) -> tuple[Poly, NDArray]:
    """Return a piece of kind "box" or "mesh" as a polyhedron.

    Args:
        piece: the piece.
        pose: the total pose, which includes the pose of the piece in the frame of its shape.

    Returns:
        The polyhedron, and its half-spaces n.x <= d as rows (n, d), shape [f, 4].
    """
    half = planes(piece)
    if piece.kind == "box":
        unit = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
        corners = unit * piece.size
    else:
        corners = np.array(piece.vertices)
    span = float(np.ptp(corners, axis=0).max())
    on = np.abs(corners @ half[:, :3].T - half[:, 3]) < 1e-9 * span
    faces = tuple(_around(corners, np.flatnonzero(on[:, k]), half[k, :3]) for k in range(len(half)))
    vertices = pose.apply(corners)
    normals = pose.apply(half[:, :3]) - pose.pos
    offset = (vertices @ normals.T).max(axis=0)
    return Poly(vertices, tuple(f for f in faces if len(f) > 2)), np.column_stack([normals, offset])


def split(solid: Poly, plane: NDArray, slack: float) -> tuple[Poly | None, Poly | None]:
    """Cut a polyhedron by the plane n.x = d, given as (n, d).

    Points within `slack` [m] of the plane count as points on the plane, so no part is thinner than
    `slack`.

    Returns:
        The part with n.x <= d and the part with n.x > d; None for an empty part.
    """
    height = solid.corners @ plane[:3] - plane[3]
    if height.max() <= slack:
        return solid, None
    if height.min() >= -slack:
        return None, solid
    return _side(solid, height, slack, plane[:3]), _side(solid, -height, slack, plane[:3])


def _side(solid: Poly, height: NDArray, slack: float, normal: NDArray) -> Poly:
    """Return the part of a polyhedron at negative heights, given the heights of its corners."""
    side_of = np.where(height > slack, 1, np.where(height < -slack, -1, 0)).tolist()
    points: list[NDArray] = []
    index: dict[tuple[int, int], int] = {}

    def corner(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in index:
            index[key] = len(points)
            p, q = solid.corners[key[0]], solid.corners[key[1]]
            if key[0] == key[1]:
                points.append(p)
            else:
                g, h = height[key[0]], height[key[1]]
                points.append(p + (q - p) * (g / (g - h)))
        return index[key]

    faces: list[tuple[int, ...]] = []
    cap: dict[int, None] = {}
    for face in solid.faces:
        loop: list[int] = []
        inside = False
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            if side_of[a] <= 0:
                loop.append(corner(a, a))
                inside |= side_of[a] < 0
                if side_of[a] == 0:
                    cap[loop[-1]] = None
            if side_of[a] * side_of[b] < 0:
                loop.append(corner(a, b))
                cap[loop[-1]] = None
        if inside and len(loop) > 2:
            faces.append(tuple(loop))
    corners = np.array(points)
    rim = _around(corners, np.array(sorted(cap), dtype=int), normal)
    if len(rim) > 2:
        faces.append(rim)
    return Poly(corners, tuple(faces))


def _around(corners: NDArray, members: NDArray, normal: NDArray) -> tuple[int, ...]:
    """Return the indices of a face's corners, in order around the face."""
    p = corners[members]
    if len(p) < 3:
        return ()
    p = p - p.mean(axis=0)
    u = p[np.argmax(np.sum(p * p, axis=1))]
    u = u - (u @ normal) * normal
    v = np.cross(normal, u)
    order = np.argsort(np.arctan2(p @ v, p @ u), kind="stable")
    return tuple(members[order].tolist())

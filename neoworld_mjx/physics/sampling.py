"""Points of objects: surface samples, at which D_pen measures penetration, and extreme points.

The extreme points determine an object's image box, and whether the object is round.
"""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from ..spec import SceneObject
from ..spec.convex import Piece, hull, planes, polytope, sphere_directions, support_points
from ..spec.pose import Pose, matrix
from .support import posed_pieces


def surface_samples(item: SceneObject, count: int) -> Float[np.ndarray, "count 3"]:
    """Spread points over an object's outer surface, with corners and midpoints of edges first.

    Points of a piece that are inside another piece are omitted. The result is deterministic.

    Args:
        item: the object. Points are in the object's frame at scale 1 [m].
        count: number of points. The last point is repeated if the surface yields fewer points.
    """
    pieces = posed_pieces(item, tilted=False)
    areas = np.array([_area(piece) for piece, _ in pieces])
    solids = [_Solid(piece, pose) for piece, pose in pieces]
    centres, radii = np.array([s.centre for s in solids]), np.array([s.radius for s in solids])
    edge_points, face_points = [], []
    for k, (piece, pose) in enumerate(pieces):
        distances = np.linalg.norm(centres - centres[k], axis=1)
        near = [j for j in np.flatnonzero(distances < radii + radii[k]).tolist() if j != k]
        target = max(12, int(np.ceil(4 * count * areas[k] / areas.sum())))
        for points, collected in (
            (_edges(piece), edge_points),
            (_faces(piece, target), face_points),
        ):
            world = pose.apply(points)
            hidden = np.zeros(len(world), bool)
            for j in near:
                solids[j].hide(world, hidden)
            collected.append(world[~hidden])
    edges, faces = np.vstack(edge_points), np.vstack(face_points)
    chosen = _farthest(edges, min(len(edges), count // 2), np.zeros((0, 3)))
    chosen = np.vstack([chosen, _farthest(faces, count - len(chosen), chosen)])
    pad = np.repeat(chosen[-1:], count - len(chosen), axis=0)
    return np.asarray(np.vstack([chosen, pad]), np.float32)


class _Solid:
    """A piece of an object that may contain points of other pieces."""

    def __init__(self, piece: Piece, pose: Pose) -> None:
        self.piece, self.pose, self.turn = piece, pose, matrix(pose.quat)
        self.half = planes(piece) if piece.kind in ("box", "mesh") else None
        corners = np.array(piece.vertices) if piece.kind == "mesh" else None
        self.centre = pose.pos if corners is None else pose.apply(corners.mean(axis=0)[None])[0]
        s = np.asarray(piece.size, float)
        self.radius = (
            float(np.linalg.norm(s)) + float(s[0])
            if corners is None
            else float(np.linalg.norm(corners - corners.mean(axis=0), axis=1).max())
        )

    def hide(self, points: NDArray, hidden: NDArray) -> None:
        """Set `hidden` [n] to True for the points [n, 3] inside the piece."""
        near = np.flatnonzero(((points - self.centre) ** 2).sum(axis=1) < self.radius**2)
        if len(near):
            local = (points[near] - self.pose.pos) @ self.turn
            hidden[near] |= _inside(self.piece, self.half, local)


def _farthest(points: NDArray, count: int, near: NDArray) -> NDArray:
    """Pick points one by one, each the farthest from `near` and the points already picked."""
    if not len(points) or count <= 0:
        return np.zeros((0, 3))
    gap = np.linalg.norm(points - points.mean(axis=0), axis=1)
    for other in near:
        gap = np.minimum(gap, np.linalg.norm(points - other, axis=1))
    picked = []
    for _ in range(min(count, len(points))):
        k = int(np.argmax(gap))
        if gap[k] <= 0 and picked:
            break
        picked.append(k)
        gap = np.minimum(gap, np.linalg.norm(points - points[k], axis=1))
    return points[picked]


def _area(piece: Piece) -> float:
    s = np.asarray(piece.size, float)
    if piece.kind == "box":
        return float(8 * (s[0] * s[1] + s[1] * s[2] + s[0] * s[2]))
    if piece.kind == "mesh":
        v, f = hull(piece.vertices)
        return float(
            np.linalg.norm(np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]]), axis=1).sum()
            / 2
        )
    if piece.kind == "sphere":
        return float(4 * np.pi * s[0] ** 2)
    if piece.kind == "ellipsoid":
        a, b, c = s**1.6075  # Thomsen's formula, accurate to 1.1 %
        return float(4 * np.pi * ((a * b + a * c + b * c) / 3) ** (1 / 1.6075))
    side = 4 * np.pi * s[0] * s[1]
    return float(side + (4 if piece.kind == "capsule" else 2) * np.pi * s[0] ** 2)


def _edges(piece: Piece) -> NDArray:
    """Return corners and points along sharp edges, in the piece's frame."""
    s = np.asarray(piece.size, float)
    if piece.kind == "box":
        grid = np.array(np.meshgrid(*([-1.0, 0.0, 1.0],) * 3)).reshape(3, -1).T
        return grid[np.abs(grid).sum(axis=1) >= 2] * s
    if piece.kind == "mesh":
        v, f = hull(piece.vertices)
        pairs = np.unique(np.sort(f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
        return np.vstack([v, v[pairs].mean(axis=1)])
    if piece.kind == "cylinder":
        turn = 2 * np.pi * np.arange(16) / 16
        ring = np.column_stack([s[0] * np.cos(turn), s[0] * np.sin(turn)])
        return np.vstack([np.column_stack([ring, np.full(16, z)]) for z in (-s[1], s[1])])
    tip = s[0] + s[1] if piece.kind == "capsule" else s[2] if piece.kind == "ellipsoid" else s[0]
    return np.array([[0, 0, tip], [0, 0, -tip]])


def _faces(piece: Piece, count: int) -> NDArray:
    """Return evenly spread points on the surface, in the piece's frame."""
    s = np.asarray(piece.size, float)
    k = np.arange(count) + 0.5
    golden = np.pi * (1 + 5**0.5)
    if piece.kind in ("box", "mesh"):
        corners = np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T * s
        v, f = hull((polytope(corners) if piece.kind == "box" else piece).vertices)
        a, b, c = v[f[:, 0]], v[f[:, 1]], v[f[:, 2]]
        share = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
        # A rank-1 lattice in (face by area, barycentric coordinates).
        pick = np.searchsorted(share, k / count * share[-1])
        u, w = (k * 0.7548776662) % 1, (k * 0.5698402910) % 1
        flip = u + w > 1
        u, w = np.where(flip, 1 - u, u), np.where(flip, 1 - w, w)
        return a[pick] + u[:, None] * (b - a)[pick] + w[:, None] * (c - a)[pick]
    if piece.kind in ("sphere", "ellipsoid"):
        return sphere_directions(count) * (s[0] if piece.kind == "sphere" else s)
    if piece.kind == "capsule":
        length = 2 * s[1] + 2 * s[0]
        z = (k / count - 0.5) * length
        over = np.maximum(np.abs(z) - s[1], 0.0)
        r = np.sqrt(np.maximum(s[0] ** 2 - over**2, 0.0))
        return np.column_stack([r * np.cos(golden * k), r * np.sin(golden * k), z])
    caps = max(4, int(count * s[0] / (s[0] + 2 * s[1])))
    t = np.arange(caps) + 0.5
    r = s[0] * np.sqrt(t / caps)
    disc = np.column_stack([r * np.cos(golden * t), r * np.sin(golden * t)])
    ends = np.column_stack([disc, np.where(np.arange(caps) % 2 == 0, s[1], -s[1])])
    wall = np.arange(count - caps) + 0.5
    z = (2 * wall / max(len(wall), 1) - 1) * s[1]
    side = np.column_stack([s[0] * np.cos(golden * wall), s[0] * np.sin(golden * wall), z])
    return np.vstack([ends, side])


def _inside(piece: Piece, half: NDArray | None, x: NDArray) -> NDArray:
    """Return a mask of points [n, 3] that are deeper in a piece than a thousandth of its size."""
    s = np.asarray(piece.size, float)
    if half is not None:
        deep = (half[:, 3] - x @ half[:, :3].T).min(axis=1)
        return deep > 1e-3 * np.abs(half[:, 3]).max()
    if piece.kind == "ellipsoid":
        return np.linalg.norm(x / s, axis=1) < 1 - 1e-3
    if piece.kind == "cylinder":
        flat = np.maximum(np.hypot(x[:, 0], x[:, 1]) - s[0], np.abs(x[:, 2]) - s[1])
        return flat < -1e-3 * s[0]
    along = np.clip(x[:, 2], -s[1], s[1]) if piece.kind == "capsule" else np.zeros(len(x))
    return np.linalg.norm(x - np.column_stack([0 * along, 0 * along, along]), axis=1) < s[0] * 0.999


HULL_DIRECTIONS = 256
"""Number of evenly spread directions in which an object's extreme points are stored."""
ROUND_TOLERANCE = 0.04
"""Largest relative variation of the radius of a round object about its axis. Regular polygons with
at least twelve corners count as round."""


def extreme_points(item: SceneObject) -> Float[np.ndarray, "direction 3"]:
    """Return the extreme points of an object, in the object's frame at scale 1 [m].

    An image box computed from these points is at most half a percent too small for a smooth object.
    """
    return _farthest_points(item, sphere_directions(HULL_DIRECTIONS))


def is_round(item: SceneObject) -> bool:
    """Return whether an object's hull is symmetric about its frame's z axis."""
    angles = np.radians(np.arange(0.0, 360.0, 10.0))
    rings = []
    for height in (-60.0, -30.0, 0.0, 30.0, 60.0):
        c, s = np.cos(np.radians(height)), np.sin(np.radians(height))
        rings.append(np.column_stack([c * np.cos(angles), c * np.sin(angles), 0 * angles + s]))
    directions = np.concatenate(rings)
    reach = np.sum(_farthest_points(item, directions) * directions, axis=1).reshape(len(rings), -1)
    max_radius = np.hypot(*_farthest_points(item, directions)[:, :2].T).max()
    return bool(np.ptp(reach, axis=1).max() < ROUND_TOLERANCE * max_radius)


def _farthest_points(item: SceneObject, directions: NDArray) -> NDArray:
    best, points = np.full(len(directions), -np.inf), np.zeros(directions.shape)
    for piece, pose in posed_pieces(item, tilted=False):
        candidates = pose.apply(support_points(piece, directions @ matrix(pose.quat)))
        reach = np.sum(candidates * directions, axis=1)
        farther = reach > best
        best[farther], points[farther] = reach[farther], candidates[farther]
    return points

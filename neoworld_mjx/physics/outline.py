"""Extreme points of objects, which determine their image boxes, and a test for roundness."""

import functools

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from ..spec import SceneObject
from ..spec.convex import Piece
from ..spec.pose import matrix
from .support import posed_pieces

HULL_DIRECTIONS = 256
"""Number of evenly spread directions in which an object's extreme points are stored."""
ROUND_TOLERANCE = 0.04
"""Largest relative variation of the radius of a round object about its axis. Regular polygons with
at least twelve corners count as round."""


def extreme_points(item: SceneObject) -> Float[np.ndarray, "direction 3"]:
    """Return the extreme points of an object, in the object's frame at scale 1 [m].

    An image box computed from these points is at most half a percent too small for a smooth object.
    """
    return _farthest(item, _directions())


def is_round(item: SceneObject) -> bool:
    """Return whether an object's hull is symmetric about its frame's z axis."""
    angles = np.radians(np.arange(0.0, 360.0, 10.0))
    rings = []
    for height in (-60.0, -30.0, 0.0, 30.0, 60.0):
        c, s = np.cos(np.radians(height)), np.sin(np.radians(height))
        rings.append(np.column_stack([c * np.cos(angles), c * np.sin(angles), 0 * angles + s]))
    directions = np.concatenate(rings)
    reach = np.sum(_farthest(item, directions) * directions, axis=1).reshape(len(rings), -1)
    max_radius = np.hypot(*_farthest(item, directions)[:, :2].T).max()
    return bool(np.ptp(reach, axis=1).max() < ROUND_TOLERANCE * max_radius)


@functools.cache
def _directions() -> NDArray:
    k = np.arange(HULL_DIRECTIONS) + 0.5
    z, turn = 1 - 2 * k / HULL_DIRECTIONS, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])


def _farthest(item: SceneObject, directions: NDArray) -> NDArray:
    best, points = np.full(len(directions), -np.inf), np.zeros(directions.shape)
    for piece, pose in posed_pieces(item, tilted=False):
        candidates = pose.apply(_support_points(piece, directions @ matrix(pose.quat)))
        reach = np.sum(candidates * directions, axis=1)
        farther = reach > best
        best[farther], points[farther] = reach[farther], candidates[farther]
    return points


def _support_points(piece: Piece, d: NDArray) -> NDArray:
    """Return the support points [n, 3] of a piece along unit directions, in the piece's frame."""
    if piece.kind == "mesh":
        v = np.asarray(piece.vertices, float)
        return v[np.argmax(d @ v.T, axis=1)]
    s, up = np.asarray(piece.size, float), np.array([0.0, 0.0, 1.0])
    if piece.kind == "box":
        return np.sign(d) * s
    if piece.kind == "sphere":
        return d * s[0]
    if piece.kind == "ellipsoid":
        return d * s**2 / np.linalg.norm(d * s, axis=1, keepdims=True)
    end = np.sign(d[:, 2:]) * s[1] * up
    if piece.kind == "capsule":
        return d * s[0] + end
    flat = d * (1 - up)
    return flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12) * s[0] + end

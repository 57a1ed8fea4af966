"""Outlines of objects: the points that give its box from anywhere, and whether it is round."""

import functools

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from ..spec import SceneObject
from ..spec.convex import Piece
from ..spec.pose import matrix
from .support import posed_pieces

HULL_DIRECTIONS = 256
"""Directions, evenly all around, in which an object's farthest points are kept."""
ROUND_SHARE = 0.04
"""Largest difference in reach about the axis, as a share of the reach, of a round object; polygons
of twelve corners or more count as round."""


def extreme_points(item: SceneObject) -> Float[np.ndarray, "direction 3"]:
    """Return the points in the object's frame at scale 1 [m] that reach farthest in HULL_DIRECTIONS.

    A smooth object's box in a picture is short of the true one by half a percent at most.
    """
    return _farthest(item, _directions())


def is_round(item: SceneObject) -> bool:
    """Return whether an object's hull is the same however it is turned about its frame's z axis."""
    turns = np.radians(np.arange(0.0, 360.0, 10.0))
    ways = []
    for height in (-60.0, -30.0, 0.0, 30.0, 60.0):
        c, s = np.cos(np.radians(height)), np.sin(np.radians(height))
        ways.append(np.column_stack([c * np.cos(turns), c * np.sin(turns), 0 * turns + s]))
    directions = np.concatenate(ways)
    reach = np.sum(_farthest(item, directions) * directions, axis=1).reshape(len(ways), -1)
    widest = np.hypot(*_farthest(item, directions)[:, :2].T).max()
    return bool(np.ptp(reach, axis=1).max() < ROUND_SHARE * widest)


@functools.cache
def _directions() -> NDArray:
    k = np.arange(HULL_DIRECTIONS) + 0.5
    z, turn = 1 - 2 * k / HULL_DIRECTIONS, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])


def _farthest(item: SceneObject, directions: NDArray) -> NDArray:
    best, points = np.full(len(directions), -np.inf), np.zeros(directions.shape)
    for piece, at in posed_pieces(item, tilted=False):
        own = at.apply(_support(piece, directions @ matrix(at.quat)))
        reach = np.sum(own * directions, axis=1)
        farther = reach > best
        best[farther], points[farther] = reach[farther], own[farther]
    return points


def _support(piece: Piece, d: NDArray) -> NDArray:
    """Return a piece's points [n, 3] that reach farthest along unit directions, in its frame."""
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

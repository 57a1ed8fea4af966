"""How much a shape holds, and how far points lie from it: of the true solid, not of its colliders.

Exact for what has straight or circular outlines. Sweeps, stretched lathes and CSG count as their
visual surface, whose facets are finer than those of the colliders.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .extruded import Extrusion, RoundedBox
from .shapes import Box, Capsule, Cylinder, Ellipsoid, Lathe, Prism, Shape, Sphere
from .surface import ring_section, section, surface

_CHUNK = 400_000
"""Points times triangles that are worked on at once."""


def volume(shape: Shape) -> float:
    """Return the volume of a shape [m^3]."""
    if isinstance(shape, Box):
        return math.prod(shape.size)
    if isinstance(shape, Sphere):
        return 4 / 3 * math.pi * shape.radius**3
    if isinstance(shape, Ellipsoid):
        return 4 / 3 * math.pi * math.prod(shape.radii)
    if isinstance(shape, Cylinder):
        return math.pi * shape.radius**2 * shape.height
    if isinstance(shape, Capsule):
        return math.pi * shape.radius**2 * (shape.length + 4 / 3 * shape.radius)
    if isinstance(shape, RoundedBox):
        r = shape.radius
        a, b, c = (edge - 2 * r for edge in shape.size)
        slabs = a * b * c + 2 * r * (a * b + b * c + c * a)
        return slabs + math.pi * r**2 * (a + b + c) + 4 / 3 * math.pi * r**3
    if isinstance(shape, Prism):
        return abs(_area(np.array(shape.outline))) * shape.height
    if isinstance(shape, Extrusion):
        loops = [abs(_area(np.array(loop))) for loop in (shape.outline, *shape.holes)]
        return (loops[0] - sum(loops[1:])) * shape.height
    if isinstance(shape, Lathe):
        p = section(shape)
        q = np.roll(p, -1, axis=0)
        # Pappus: the area's moment about the axis goes once around.
        moment = np.sum((p[:, 0] + q[:, 0]) * (p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1])) / 6
        return 2 * math.pi * abs(float(moment)) * shape.oval
    vertices, faces = surface(shape)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6)


def signed_distance(shape: Shape, points: ArrayLike) -> NDArray:
    """Return how far points lie from a shape's surface, positive outside and negative inside.

    Args:
        shape: the shape.
        points: in the shape's frame [n, 3] m.

    Returns:
        Distances [n] m.
    """
    p = np.atleast_2d(np.asarray(points, float))
    if isinstance(shape, Box):
        return _box(p, np.array(shape.size) / 2)
    if isinstance(shape, RoundedBox):
        return _box(p, np.array(shape.size) / 2 - shape.radius) - shape.radius
    if isinstance(shape, Sphere):
        return np.linalg.norm(p, axis=1) - shape.radius
    if isinstance(shape, Capsule):
        along = np.maximum(np.abs(p[:, 2]) - shape.length / 2, 0.0)
        return np.hypot(np.hypot(p[:, 0], p[:, 1]), along) - shape.radius
    if isinstance(shape, Cylinder):
        return _extruded(np.hypot(p[:, 0], p[:, 1]) - shape.radius, p[:, 2], shape.height / 2)
    if isinstance(shape, Ellipsoid):
        return _ellipsoid(p, np.array(shape.radii))
    if isinstance(shape, Prism):
        return _extruded(_loops(p[:, :2], [shape.outline]), p[:, 2], shape.height / 2)
    if isinstance(shape, Extrusion):
        loops = [shape.outline, *shape.holes]
        return _extruded(_loops(p[:, :2], loops), p[:, 2], shape.height / 2)
    if isinstance(shape, Lathe) and shape.oval == 1.0:
        return _turned(shape, p)
    return _mesh(shape, p)


def _box(p: NDArray, half: NDArray) -> NDArray:
    q = np.abs(p) - half
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def _extruded(flat: NDArray, z: NDArray, half: float) -> NDArray:
    """Combine the distance to an outline in the plane with that to the two ends."""
    over = np.abs(z) - half
    outside = np.hypot(np.maximum(flat, 0.0), np.maximum(over, 0.0))
    return outside + np.minimum(np.maximum(flat, over), 0.0)


def _loops(p: NDArray, loops: list[tuple[tuple[float, float], ...]]) -> NDArray:
    """Return the signed distance [n] of points [n, 2] to an outline with holes."""
    a = np.vstack([np.array(loop, float) for loop in loops])
    b = np.vstack([np.roll(np.array(loop, float), -1, axis=0) for loop in loops])
    return _to_edges(p, a, b) * np.where(_within(p, a, b), -1.0, 1.0)


def _to_edges(p: NDArray, a: NDArray, b: NDArray) -> NDArray:
    edge = b - a
    length = np.maximum(np.sum(edge * edge, axis=1), 1e-300)
    best = np.full(len(p), np.inf)
    for i in range(0, len(p), max(1, _CHUNK // len(a))):
        own = slice(i, i + max(1, _CHUNK // len(a)))
        from_a = p[own, None] - a
        t = np.clip(np.sum(from_a * edge, axis=2) / length, 0.0, 1.0)
        gap = from_a - t[..., None] * edge
        best[own] = np.sqrt(np.sum(gap * gap, axis=2).min(axis=1))
    return best


def _within(p: NDArray, a: NDArray, b: NDArray) -> NDArray:
    """Count the edges to the right of each point; inside, it is odd."""
    x, y = p[:, :1], p[:, 1:]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return np.sum(crosses & (at > x), axis=1) % 2 == 1


def _turned(shape: Lathe, p: NDArray) -> NDArray:
    chain = section(shape)
    flat = np.column_stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]])
    if ring_section(shape):
        return _loops(flat, [tuple(map(tuple, chain.tolist()))])
    a, b = chain[:-1], chain[1:]
    # The edge along the axis closes the outline, but is no surface.
    inside = _within(flat, chain, np.roll(chain, -1, axis=0))
    return _to_edges(flat, a, b) * np.where(inside, -1.0, 1.0)


def _ellipsoid(p: NDArray, radii: NDArray) -> NDArray:
    """Find the nearest point by bisection (Eberly, Distance from a Point to an Ellipsoid)."""
    order = np.argsort(-radii, kind="stable")
    r = radii[order]
    y = np.maximum(np.abs(p[:, order]), 1e-9 * r)
    least = r[2] ** 2
    low = np.log(r[2] * y[:, 2] * 0.5)
    high = np.log(np.sqrt(np.sum((r * y) ** 2, axis=1)) * 1.001 + 1e-300)
    for _ in range(100):
        middle = (low + high) / 2
        shift = np.exp(middle)[:, None] - least
        outside = np.sum((r * y / (shift + r**2)) ** 2, axis=1) > 1
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    shift = np.exp((low + high) / 2)[:, None] - least
    nearest = r**2 * y / (shift + r**2)
    sign = np.where(np.sum((y / r) ** 2, axis=1) > 1, 1.0, -1.0)
    return sign * np.linalg.norm(nearest - y, axis=1)


def _mesh(shape: Shape, p: NDArray) -> NDArray:
    vertices, faces = surface(shape)
    corners = vertices[faces]
    step = max(1, _CHUNK // len(faces))
    found = np.empty(len(p))
    for i in range(0, len(p), step):
        own = p[i : i + step, None]
        near = _to_triangles(own, corners)
        found[i : i + step] = near * np.where(_winding(own, corners) > 0.5, -1.0, 1.0)
    return found


def _to_triangles(p: NDArray, corners: NDArray) -> NDArray:
    """Return the distance [n] of points [n, 1, 3] to the nearest of triangles [f, 3, 3]."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    best = np.full((len(p), len(corners)), np.inf)
    over = np.ones((len(p), len(corners)), bool)
    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        edge, from_a = b - a, p - a
        t = np.sum(from_a * edge, axis=2) / np.maximum(np.sum(edge * edge, axis=1), 1e-300)
        gap = from_a - np.clip(t, 0.0, 1.0)[..., None] * edge
        best = np.minimum(best, np.sum(gap * gap, axis=2))
        over &= np.sum(np.cross(unit, edge) * from_a, axis=2) >= 0
    height = np.sum((p - corners[:, 0]) * unit, axis=2)
    return np.sqrt(np.where(over, height**2, best).min(axis=1))


def _winding(p: NDArray, corners: NDArray) -> NDArray:
    """Return how often a surface winds around points (Van Oosterom and Strackee, 1983)."""
    a, b, c = (corners[:, k] - p for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    dot = lambda u, v: np.sum(u * v, axis=2)
    above = dot(a, np.cross(b, c))
    below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    return np.sum(np.arctan2(above, below), axis=1) / (2 * np.pi)


def _area(p: NDArray) -> float:
    q = np.roll(p, -1, axis=0)
    return float(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]) / 2)


__all__ = ["signed_distance", "volume"]

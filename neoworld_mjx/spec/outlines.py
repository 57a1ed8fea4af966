"""Polygons in the plane: areas, and signed distances to outlines, boxes and extrusions."""

import numpy as np
from numpy.typing import NDArray

from .triangles import MAX_PAIRS

HULL_EDGE_SAMPLES = 17
"""Number of points along each edge of a hull at which the distance to the polygons is measured."""


def box_distance(p: NDArray, half: NDArray) -> NDArray:
    """Return the distances [n] of points [n, 3] to a centered box with half edge lengths [3]."""
    q = np.abs(p) - half
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def extruded_distance(flat: NDArray, z: NDArray, half: float) -> NDArray:
    """Return distances to an extrusion, given distances to its outline in the plane.

    Args:
        flat: signed distances of the points to the outline [n].
        z: heights of the points [n].
        half: half the height of the extrusion, whose ends are at z = +-half.
    """
    over = np.abs(z) - half
    outside = np.hypot(np.maximum(flat, 0.0), np.maximum(over, 0.0))
    return outside + np.minimum(np.maximum(flat, over), 0.0)


def loops_distance(p: NDArray, loops: list[NDArray]) -> NDArray:
    """Return the distances [n] of points [n, 2] to an outline with holes, negative inside."""
    a = np.vstack(loops)
    b = np.vstack([np.roll(loop, -1, axis=0) for loop in loops])
    return edges_distance(p, a, b) * np.where(inside_edges(p, a, b), -1.0, 1.0)


def edges_distance(p: NDArray, a: NDArray, b: NDArray) -> NDArray:
    """Return the distances [n] of points [n, 2] to the nearest of the edges from a to b [e, 2]."""
    edge = b - a
    length = np.maximum(np.sum(edge * edge, axis=1), 1e-300)
    best = np.full(len(p), np.inf)
    for i in range(0, len(p), max(1, MAX_PAIRS // len(a))):
        chunk = slice(i, i + max(1, MAX_PAIRS // len(a)))
        from_a = p[chunk, None] - a
        t = np.clip(np.sum(from_a * edge, axis=2) / length, 0.0, 1.0)
        gap = from_a - t[..., None] * edge
        best[chunk] = np.sqrt(np.sum(gap * gap, axis=2).min(axis=1))
    return best


def inside_edges(p: NDArray, a: NDArray, b: NDArray) -> NDArray:
    """Return a mask [n] of the points [n, 2] that lie inside closed loops of edges.

    A point lies inside if the number of edges to its right is odd.
    """
    x, y = p[:, :1], p[:, 1:]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return np.sum(crosses & (crossing > x), axis=1) % 2 == 1


def hull_excess(polygons: list[NDArray]) -> float:
    """Return the largest distance between neighboring polygons [n, 2] and their convex hull."""
    from scipy.spatial import ConvexHull

    corners = np.vstack(polygons)
    low, span = corners.min(axis=0), np.ptp(corners, axis=0).max()
    around = corners[ConvexHull((corners - low) / span).vertices]
    # The largest distance is at edges of the hull that span a gap.
    along = np.linspace(0.0, 1.0, HULL_EDGE_SAMPLES)[:, None, None]
    lids = around + along * (np.roll(around, -1, axis=0) - around)
    a, b = corners, np.vstack([np.roll(polygon, -1, axis=0) for polygon in polygons])
    return float(edges_distance(lids.reshape(-1, 2), a, b).max())


def polygon_area(p: NDArray) -> float:
    """Return the area of a polygon [n, 2], positive if its corners run counterclockwise."""
    q = np.roll(p, -1, axis=0)
    return float(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]) / 2)

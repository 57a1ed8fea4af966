"""Extents of the part of a surface within the picture, from edges clipped at the picture's border.

The visible box of an object that the border cuts ends where its edges leave the picture, which
locates the object as accurately as a fully visible outline.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

from ..spec import Camera
from .projection import NEAR_M

MARGIN = 0.15
"""Maximum motion in the picture that `near_border` allows, over the longer side."""


class Wireframe(NamedTuple):
    """Points of a surface, and the edges between them."""

    hull: Float[np.ndarray, "_ 3"]
    """Corners of the convex hull."""
    points: Float[np.ndarray, "n 3"]
    edges: Int[np.ndarray, "e 2"]
    """Indices of the two points of each edge."""


def hull_wireframe(points: Float[np.ndarray, "_ 3"]) -> Wireframe:
    """Return the convex hull of points; if they are coplanar, all pairs of them."""
    try:
        hull = ConvexHull(points)
    except QhullError:
        return Wireframe(points, points, np.column_stack(np.triu_indices(len(points), 1)))
    return Wireframe(points[hull.vertices], points, edges_of(hull.simplices))


def edges_of(triangles: Int[np.ndarray, "t 3"]) -> Int[np.ndarray, "e 2"]:
    """Return the edges of triangles, each once."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(pairs, axis=1), axis=0)


def extents_in_picture(
    camera: Camera,
    view: Float[np.ndarray, "n 3"],
    edges: Int[np.ndarray, "e 2"],
) -> Float[np.ndarray, "4"] | None:
    """Return the box [px] (x0, y0, x1, y1) of the part of a surface within the picture.

    Args:
        camera: the camera.
        view: the surface's points in the camera frame (right, down, forward) [m].
        edges: indices of the two points of each edge.

    Returns:
        None if the surface is out of the picture.
    """
    ends = view[edges]
    depth = ends[..., 2] - NEAR_M
    ahead = np.any(depth > 0, axis=1)
    ends, depth = ends[ahead], depth[ahead]
    crosses = np.any(depth < 0, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (depth[:, 0] / (depth[:, 0] - depth[:, 1]))[:, None]
        crossing = np.where(crosses[:, None], ends[:, 0] + share * (ends[:, 1] - ends[:, 0]), 0.0)
    ends = np.where((depth < 0)[..., None], crossing[:, None], ends)
    size = np.array([camera.width, camera.height_px], float)
    pixels = ends[..., :2] / np.maximum(ends[..., 2:], NEAR_M) * camera.focal + size / 2
    # The line from a to b is within the picture from fraction `enter` to `leave` of its length.
    a, b = pixels[:, 0], pixels[:, 1]
    enter, leave = np.zeros(len(a)), np.ones(len(a))
    for axis in range(2):
        for inside_a, inside_b in (
            (a[:, axis], b[:, axis]),
            (size[axis] - a[:, axis], size[axis] - b[:, axis]),
        ):
            with np.errstate(divide="ignore", invalid="ignore"):
                t = inside_a / (inside_a - inside_b)
            enter = np.where((inside_a < 0) & (inside_b >= 0), np.maximum(enter, t), enter)
            leave = np.where((inside_b < 0) & (inside_a >= 0), np.minimum(leave, t), leave)
            leave = np.where((inside_a < 0) & (inside_b < 0), -1.0, leave)
    shown = enter <= leave
    a, direction = a[shown], (b - a)[shown]
    corners = np.array([[0, 0], [size[0], 0], size, [0, size[1]]])
    flat = pixels.reshape(-1, 2)
    low, high = flat.min(axis=0, initial=np.inf), flat.max(axis=0, initial=-np.inf)
    near = ((low <= corners) & (corners <= high)).all(axis=1)
    covered = corners[[n and _surrounds(flat, c) for n, c in zip(near, corners, strict=True)]]
    points = np.concatenate(
        [a + enter[shown, None] * direction, a + leave[shown, None] * direction, covered]
    )
    if len(points) == 0:
        return None
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


def near_border(
    camera: Camera, view: Float[np.ndarray, "n 3"], edges: Int[np.ndarray, "e 2"]
) -> Int[np.ndarray, "k 2"]:
    """Return the edges that can determine a surface's box in the picture after small motions.

    These are the edges that may intersect the border, and those at the extreme points within it. A
    tube has thousands of others.

    Args:
        camera: the camera.
        view: the surface's points in the camera frame (right, down, forward) [m].
        edges: indices of the two points of each edge.
    """
    size = np.array([camera.width, camera.height_px], float)
    margin = MARGIN * size.max()
    pixels = view[:, :2] / np.maximum(view[:, 2:], NEAR_M) * camera.focal + size / 2
    inner = ((pixels > margin) & (pixels < size - margin)).all(axis=1) & (view[:, 2] > NEAR_M)
    extreme = np.zeros(len(pixels), bool)
    if inner.sum() > 3:
        try:
            extreme[np.flatnonzero(inner)[ConvexHull(pixels[inner]).vertices]] = True
        except QhullError:  # The points are collinear.
            extreme |= inner
    ends = pixels[edges]
    far = ((ends < -margin).all(axis=1) | (ends > size + margin).all(axis=1)).any(axis=1)
    far &= (view[edges][..., 2] > NEAR_M).all(axis=1)
    within = inner[edges].all(axis=1) & ~extreme[edges].any(axis=1)
    kept = edges[~far & ~within]
    return kept if len(kept) else edges


def _surrounds(points: Float[np.ndarray, "n 2"], spot: Float[np.ndarray, "2"]) -> bool:
    """Return True if a point lies in the convex hull of others."""
    if len(points) == 0:
        return False
    angles = np.sort(np.arctan2(points[:, 1] - spot[1], points[:, 0] - spot[0]))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    return bool(gaps.max() < np.pi)

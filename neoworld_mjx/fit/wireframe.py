"""Extents of the visible part of a surface, from edges clipped at the picture's border.

If the border cuts an object, the object's visible box ends where its edges leave the picture. This
determines the object's position as accurately as a fully visible outline does.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

from ..spec import Camera
from .projection import NEAR_M

MARGIN = 0.15
"""Maximum motion in the picture that `near_border` allows for, relative to the picture's longer
side."""


class Wireframe(NamedTuple):
    """Points of a surface, and the edges between them."""

    hull: Float[np.ndarray, "_ 3"]
    """Corners of the convex hull."""
    points: Float[np.ndarray, "n 3"]
    edges: Int[np.ndarray, "e 2"]
    """Indices of the two points of each edge."""


def hull_wireframe(points: Float[np.ndarray, "_ 3"]) -> Wireframe:
    """Return the edges of the convex hull of points; if the points are coplanar, all pairs."""
    try:
        hull = ConvexHull(points)
    except QhullError:
        return Wireframe(points, points, np.column_stack(np.triu_indices(len(points), 1)))
    return Wireframe(points[hull.vertices], points, edges_of(hull.simplices))


def edges_of(triangles: Int[np.ndarray, "t 3"]) -> Int[np.ndarray, "e 2"]:
    """Return the edges of triangles; each edge occurs once."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(pairs, axis=1), axis=0)


class CutSurfaces(NamedTuple):
    """Surfaces of the objects that the picture's border may cut."""

    rows: Int[np.ndarray, " s"]
    """Index of each surface's object."""
    points: Float[np.ndarray, "s p 3"]
    edges: Int[np.ndarray, "e 2"]
    """Indices of the points of each edge among the points of all surfaces."""
    owners: Int[np.ndarray, " e"]
    """Index of each edge's surface, ascending."""


def stack_surfaces(frames: Mapping[int, Wireframe]) -> CutSurfaces:
    """Stack wireframes, given by index of their object."""
    points = stacked([frame.points for frame in frames.values()])
    edges = [k * points.shape[1] + frame.edges for k, frame in enumerate(frames.values())]
    return CutSurfaces(
        np.array(list(frames), int),
        points,
        np.concatenate([np.zeros((0, 2), int), *edges]),
        np.arange(len(frames)).repeat([len(e) for e in edges]),
    )


def repeated_surfaces(surfaces: CutSurfaces, count: int, objects: int) -> CutSurfaces:
    """Return `count` copies of surfaces; copy k belongs to objects shifted by k * `objects`."""
    copies = np.arange(count)
    number, corners = surfaces.points.shape[:2]
    return CutSurfaces(
        (copies[:, None] * objects + surfaces.rows).ravel(),
        np.concatenate([surfaces.points] * count),
        (copies[:, None, None] * number * corners + surfaces.edges).reshape(-1, 2),
        (copies[:, None] * number + surfaces.owners).ravel(),
    )


def stacked(points: Sequence[Float[np.ndarray, "_ 3"]]) -> Float[np.ndarray, "n m 3"]:
    """Stack point sets; shorter sets repeat points, which does not change their extents."""
    longest = max((len(p) for p in points), default=0)
    return np.array([np.resize(p, (longest, 3)) for p in points]).reshape(len(points), longest, 3)


def extents_in_picture(
    camera: Camera,
    view: Float[np.ndarray, "s p 3"],
    edges: Int[np.ndarray, "e 2"],
    owners: Int[np.ndarray, " e"],
) -> Float[np.ndarray, "s 4"]:
    """Return the box (x0, y0, x1, y1) of the part of each surface within the picture [px].

    Args:
        camera: the camera.
        view: the surfaces' points in the camera frame (right, down, forward) [m].
        edges: indices of the two points of each edge among the points of all surfaces.
        owners: index of each edge's surface, ascending.

    Returns:
        The boxes; NaN for a surface outside the picture.
    """
    count = len(view)
    ends = view.reshape(-1, 3)[edges]
    depth = ends[..., 2] - NEAR_M
    ahead = np.any(depth > 0, axis=1)
    ends, depth, owners = ends[ahead], depth[ahead], owners[ahead]
    crosses = np.any(depth < 0, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = (depth[:, 0] / (depth[:, 0] - depth[:, 1]))[:, None]
        crossing = np.where(
            crosses[:, None], ends[:, 0] + fraction * (ends[:, 1] - ends[:, 0]), 0.0
        )
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
    a, direction, visible_owners = a[shown], (b - a)[shown], owners[shown]
    shown_ends = [a + enter[shown, None] * direction, a + leave[shown, None] * direction]
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for points in shown_ends:
        np.minimum.at(low, visible_owners, points)
        np.maximum.at(high, visible_owners, points)
    for surface, corner in _covered_corners(pixels, owners, count, size):
        low[surface] = np.minimum(low[surface], corner)
        high[surface] = np.maximum(high[surface], corner)
    box = np.concatenate([low, high], axis=1)
    return np.where(np.isfinite(box), box, np.nan)


def _covered_corners(
    pixels: Float[np.ndarray, "k 2 2"],
    owners: Int[np.ndarray, " k"],
    count: int,
    size: Float[np.ndarray, "2"],
) -> Iterator[tuple[int, Float[np.ndarray, "2"]]]:
    """Yield the corners of the picture [px] that surfaces cover, each with its surface's index."""
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, owners, pixels.min(axis=1))
    np.maximum.at(high, owners, pixels.max(axis=1))
    corners = np.array([[0, 0], [size[0], 0], size, [0, size[1]]])
    candidates = ((low[:, None] <= corners) & (corners <= high[:, None])).all(axis=2)
    for surface, corner in zip(*np.nonzero(candidates), strict=True):
        rows = slice(*np.searchsorted(owners, [surface, surface + 1]))
        if _surrounds(pixels[rows].reshape(-1, 2), corners[corner]):
            yield int(surface), corners[corner]


def near_border(
    camera: Camera, view: Float[np.ndarray, "n 3"], edges: Int[np.ndarray, "e 2"]
) -> Int[np.ndarray, "k 2"]:
    """Return the edges that can determine a surface's box in the picture after small motions.

    These are the edges that may intersect the border, and the edges at the extreme points within
    the picture. A tube has thousands of other edges.

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
    outside = ((ends < -margin).all(axis=1) | (ends > size + margin).all(axis=1)).any(axis=1)
    outside &= (view[edges][..., 2] > NEAR_M).all(axis=1)
    within = inner[edges].all(axis=1) & ~extreme[edges].any(axis=1)
    remaining = edges[~outside & ~within]
    return remaining if len(remaining) else edges


def _surrounds(points: Float[np.ndarray, "n 2"], spot: Float[np.ndarray, "2"]) -> bool:
    """Return True if the point `spot` lies in the convex hull of other points."""
    if len(points) == 0:
        return False
    angles = np.sort(np.arctan2(points[:, 1] - spot[1], points[:, 0] - spot[0]))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    return bool(gaps.max() < np.pi)

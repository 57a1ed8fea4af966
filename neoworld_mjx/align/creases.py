"""Creases: lines in the image where two smooth faces of one object meet.

The two faces differ in shading or color. Creases therefore show the object's heading and
proportions. Parallel creases converge in the image and therefore also show the camera's pose. As
for contours, the colors on the two sides of a crease determine its position.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .colors import LEAST_PIXELS, FaceColors
from .contours import NORMAL_BLUR_PX, REACH_PX, Contour, sampled_contour
from .rasterize import DrawnObjects, window_of

SMOOTH = np.radians(35.0)
"""Largest angle between neighboring triangles of the same smooth face [rad]."""
LEAST_PX = 8
"""Least number of pairs of neighboring pixels along a crease."""
MOST_POINTS = 100
"""Largest number of points of a crease."""
BLUR_REACH_PX = math.ceil(4 * NORMAL_BLUR_PX) + 2
"""Distance beyond which pixels do not change the gradient of the smoothed mask."""


class Crease(NamedTuple):
    """A visible crease of an object."""

    points: Contour
    """Points on the crease; normals point from the first face to the second."""
    colors: FaceColors
    """Color models of the first and the second face."""


class _Borders(NamedTuple):
    """Pairs of neighboring pixels that show two faces; each pair occurs once."""

    first: Int[np.ndarray, " n"]
    """Index of the face at the first pixel; it is smaller than the index at the second pixel."""
    second: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    """Row of the first pixel."""
    column: Int[np.ndarray, " n"]
    down: Int[np.ndarray, " n"]
    """Number of rows from the first pixel to the second."""
    right: Int[np.ndarray, " n"]


def smooth_faces(
    vertices: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "t 3"]
) -> Int[np.ndarray, " t"]:
    """Return the index of the smooth face of each triangle of a surface.

    Smooth faces end at sharp edges.
    """
    if not len(triangles):
        return np.zeros(0, int)
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    mesh.merge_vertices()
    smooth = mesh.face_adjacency[mesh.face_adjacency_angles < SMOOTH]
    graph = coo_array((np.ones(len(smooth)), smooth.T), shape=(len(triangles),) * 2)
    return connected_components(graph, directed=False)[1]


def creases(
    drawn: DrawnObjects, lab: Float[np.ndarray, "row column 3"], k: int, margin: int
) -> Iterator[Crease]:
    """Yield each visible crease of an object if both of its faces show enough pixels.

    Points near the end of a crease are omitted if another face lies two margins away along their
    normals.

    Args:
        drawn: the objects rendered in a placement, with their faces.
        lab: the photograph [CIE Lab].
        k: index of the object.
        margin: width of the margin [px] along a face's border that the color models omit.
    """
    mask = drawn.owner == k
    if drawn.face is None or not mask.any():
        return
    window = window_of(mask, REACH_PX)
    corner = np.array([window[1].start, window[0].start])
    face = np.where(mask[window], drawn.face[window], -1)
    depth, lab = drawn.depth[window], lab[window]
    bodies = (drawn.owner if drawn.body is None else drawn.body)[window]
    borders = _borders(face)
    pairs, pair_of, counts = np.unique(
        np.stack(borders[:2]), axis=1, return_inverse=True, return_counts=True
    )
    long = np.flatnonzero(counts >= LEAST_PX)
    colors = {f: _colors(face == f, lab, margin) for f in np.unique(pairs[:, long]).tolist()}
    for index in long.tolist():
        first, second = pairs[:, index].tolist()
        inside, outside = colors[first], colors[second]
        if inside is None or outside is None:
            continue
        _, _, y, x, down, right = (values[pair_of == index] for values in borders)
        here, there = (y, x), (y + down, x + right)
        # Only pixels near the crease determine its normals.
        near = tuple(slice(max(v.min() - BLUR_REACH_PX, 0), v.max() + BLUR_REACH_PX) for v in here)
        side = (face[near] == first).astype(float)
        slope = np.gradient(gaussian_filter(side, NORMAL_BLUR_PX, mode="nearest"))
        spot = tuple(v - part.start for v, part in zip(here, near, strict=True))
        points = sampled_contour(
            corner + np.stack([x + (1 + right) / 2, y + (1 + down) / 2], axis=1),
            np.minimum(depth[here], depth[there]),
            -np.stack([slope[1][spot], slope[0][spot]], axis=1),
            np.full(len(x), -1),
            np.where(depth[here] <= depth[there], bodies[here], bodies[there]),
            shape=drawn.owner.shape,
            most=MOST_POINTS,
        )
        if points is None:
            continue
        sides = [_at(face, points.pixel - corner + s * margin * points.normal) for s in (-2, 2)]
        between = np.flatnonzero((sides[0] == first) & (sides[1] == second))
        if len(between) >= LEAST_PX:
            points = Contour(*(values[between] for values in points))
            yield Crease(points, FaceColors.of(inside, outside))


def _at(
    face: Int[np.ndarray, "row column"], pixel: Float[np.ndarray, "n 2"]
) -> Int[np.ndarray, " n"]:
    """Return the face at each position [px]; positions outside the window are clipped to it."""
    column, row = np.floor(pixel).astype(int).T
    height, width = face.shape
    return face[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]


def _borders(face: Int[np.ndarray, "row column"]) -> _Borders:
    """Return the pairs of neighboring pixels at which two faces meet."""
    found = []
    for right, down in ((1, 0), (0, 1)):
        height, width = face.shape[0] - down, face.shape[1] - right
        one, other = face[:height, :width], face[down:, right:]
        row, column = np.nonzero((one != other) & (one >= 0) & (other >= 0))
        one, other = one[row, column], other[row, column]
        swap = one > other
        sign = np.where(swap, -1, 1)
        pair = np.minimum(one, other), np.maximum(one, other)
        start = row + swap * down, column + swap * right
        found.append(np.stack([*pair, *start, sign * down, sign * right]))
    return _Borders(*np.concatenate(found, axis=1))


def _colors(
    mask: Bool[np.ndarray, "row column"], lab: Float[np.ndarray, "row column 3"], margin: int
) -> Float[np.ndarray, "n 3"] | None:
    """Return the colors of a face's inner pixels, or None if there are too few."""
    window = window_of(mask)
    mask, lab = mask[window], lab[window]
    depth = np.asarray(distance_transform_edt(np.pad(mask, 1)))[1:-1, 1:-1]
    for width in (margin, 1):
        inner = depth > width
        if inner.sum() >= LEAST_PIXELS:
            return lab[inner]
    return None

"""Overlap of boxes: 2D boxes in images, and upright 3D boxes with a yaw."""

import itertools

import numpy as np
from numpy.typing import NDArray

from ..spec import Box2D, Box3D, TreeNode
from ..spec.outlines import polygon_area
from ..spec.pose import ArrayLike


def iou_2d(a: Box2D | ArrayLike, b: Box2D | ArrayLike) -> float:
    """Return the intersection over union of two boxes in pixels (x0, y0, x1, y1)."""
    first, second = _corners(a), _corners(b)
    common = intersection_2d(first, second)
    union = _area(first) + _area(second) - common
    return common / union if union > 0 else 0.0


def intersection_2d(a: Box2D | ArrayLike, b: Box2D | ArrayLike) -> float:
    """Return the intersection area [px^2] of two boxes in pixels."""
    first, second = _corners(a), _corners(b)
    sides = np.minimum(first[2:], second[2:]) - np.maximum(first[:2], second[:2])
    return float(np.prod(np.maximum(sides, 0.0)))


def footprint(box: Box3D) -> NDArray:
    """Return the corners of an upright box's footprint [m], counterclockwise, shape [4, 2]."""
    half = np.array(box.size[:2]) / 2
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    return signs * half @ np.array([[c, s], [-s, c]]) + np.array(box.position[:2])


def support_footprint(node: TreeNode) -> NDArray:
    """Return the corners of a node's footprint [m], counterclockwise, shape [n, 2].

    The footprint has the shape of the node's outline. The footprint of a tilted node is that of the
    upright bounding box.
    """
    box = upright(node)
    if node.outline.shape == "rectangle" or box is not node.box3d:
        return footprint(box)
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    local = node.outline.corners() * np.array(box.size[:2])
    return local @ np.array([[c, s], [-s, c]]) + np.array(box.position[:2])


def polygon_intersection(a: NDArray, b: NDArray) -> float:
    """Return the intersection area of two polygons [m^2].

    The polygons are given by their corners [m], counterclockwise, shape [n, 2]. Polygon `b` must be
    convex.
    """
    # Plain floats: a scene has many pairs, and NumPy is slower for arrays of four points.
    clipped, corners = a.tolist(), b.tolist()
    for (x0, y0), (x1, y1) in itertools.pairwise([*corners, corners[0]]):
        heights = [(y - y0) * (x1 - x0) - (x - x0) * (y1 - y0) for x, y in clipped]
        points = []
        for k, (x, y) in enumerate(clipped):
            j = (k + 1) % len(clipped)
            if heights[k] >= 0:
                points.append((x, y))
            if (heights[k] >= 0) != (heights[j] >= 0):
                share = heights[k] / (heights[k] - heights[j])
                points.append((x + share * (clipped[j][0] - x), y + share * (clipped[j][1] - y)))
        if not points:
            return 0.0
        clipped = points
    return max(polygon_area(np.array(clipped)), 0.0)


def intersection_3d(a: Box3D, b: Box3D) -> float:
    """Return the intersection volume [m^3] of two upright boxes."""
    low = max(a.position[2], b.position[2])
    high = min(a.position[2] + a.size[2], b.position[2] + b.size[2])
    if high <= low:
        return 0.0
    return polygon_intersection(footprint(a), footprint(b)) * (high - low)


def iou_3d(a: Box3D, b: Box3D) -> float:
    """Return the intersection over union of two upright boxes, by volume. The yaws may differ."""
    common = intersection_3d(a, b)
    union = float(np.prod(a.size) + np.prod(b.size)) - common
    return common / union


def upright(node: TreeNode) -> Box3D:
    """Return the upright bounding box of a node's tilted box. Both boxes have the same yaw."""
    box = node.box3d
    if abs(node.base_tilt[0]) > 1 - 1e-12:
        return box
    local = Box3D(position=(0, 0, 0), size=box.size, yaw=0).corners(node.base_tilt)
    low, high = local.min(axis=0), local.max(axis=0)
    middle = (low + high)[:2] / 2
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    x, y, z = box.position
    return Box3D(
        position=(
            float(x + c * middle[0] - s * middle[1]),
            float(y + s * middle[0] + c * middle[1]),
            z,
        ),
        size=tuple((high - low).tolist()),
        yaw=box.yaw,
    )


def _corners(box: Box2D | ArrayLike) -> NDArray:
    return np.asarray(box.as_tuple() if isinstance(box, Box2D) else box, float)


def _area(box: NDArray) -> float:
    return float(max(box[2] - box[0], 0.0) * max(box[3] - box[1], 0.0))

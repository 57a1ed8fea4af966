"""Seeing 3D boxes through the parsed camera: outlines and what of them the picture holds."""

import numpy as np
from numpy.typing import NDArray

from ..spec import Camera

NEAR_M = 0.02
"""What is nearer to the camera than this along the view is cut off."""

# Corners of Box3D.corners are in the order of (x, y, z) counted in binary, x slowest.
_EDGES = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


def edges_in_view(camera: Camera, corners: NDArray) -> list[tuple[NDArray, NDArray]]:
    """Return the edges of a box as pairs of pixels [2], cut off before the camera.

    Args:
        camera: the camera.
        corners: of the box [8, 3] m, in the order of `Box3D.corners`.
    """
    local = (corners - camera.position()) @ camera.axes()
    lines = []
    for i, j in _EDGES:
        a, b = local[i], local[j]
        if a[2] < NEAR_M and b[2] < NEAR_M:
            continue
        if a[2] < NEAR_M:
            a = b + (a - b) * (b[2] - NEAR_M) / (b[2] - a[2])
        elif b[2] < NEAR_M:
            b = a + (b - a) * (a[2] - NEAR_M) / (a[2] - b[2])
        lines.append((_pixel(camera, a), _pixel(camera, b)))
    return lines


def seen_box(camera: Camera, corners: NDArray) -> NDArray | None:
    """Return the box [4] in pixels (x0, y0, x1, y1) of what the picture shows of a 3D box.

    The box's faces are cut at a plane just before the camera and at the picture's edges.

    Args:
        camera: the camera.
        corners: of the box [8, 3] m, in the order of `Box3D.corners`.

    Returns:
        None if nothing of it is in the picture.
    """
    local = (corners - camera.position()) @ camera.axes()
    near = np.array([0.0, 0.0, 1.0, -NEAR_M])
    sides = [
        np.array([1.0, 0.0, 0.0, 0.0]),
        np.array([-1.0, 0.0, 0.0, camera.width]),
        np.array([0.0, 1.0, 0.0, 0.0]),
        np.array([0.0, -1.0, 0.0, camera.height_px]),
    ]
    points = []
    for face in _FACES:
        polygon = _cut(local[list(face)], near)
        if len(polygon) == 0:
            continue
        flat = np.column_stack([_pixel(camera, polygon), np.zeros(len(polygon))])
        for side in sides:
            flat = _cut(flat, side)
        points.append(flat[:, :2])
    found = np.concatenate(points) if points else np.zeros((0, 2))
    if len(found) == 0:
        return None
    return np.concatenate([found.min(axis=0), found.max(axis=0)])


def _pixel(camera: Camera, local: NDArray) -> NDArray:
    centre = np.array([camera.width / 2, camera.height_px / 2])
    return local[..., :2] / local[..., 2:3] * camera.focal + centre


def _cut(polygon: NDArray, plane: NDArray) -> NDArray:
    """Cut a convex polygon [n, 3] by a plane (normal, offset), keeping the positive side."""
    if len(polygon) == 0:
        return polygon
    height = polygon @ plane[:3] + plane[3]
    kept = []
    for k in range(len(polygon)):
        j = (k + 1) % len(polygon)
        if height[k] >= 0:
            kept.append(polygon[k])
        if (height[k] >= 0) != (height[j] >= 0):
            share = height[k] / (height[k] - height[j])
            kept.append(polygon[k] + share * (polygon[j] - polygon[k]))
    return np.array(kept).reshape(-1, 3)

"""Large flat faces of objects, found in a rendered image."""

from typing import cast

import numpy as np
from jaxtyping import Bool
from scipy import ndimage

from .rendering import RenderedImage
from .view import View

LEAST_SHARE = 0.004
"""Smallest fraction of the image that a face covers."""
LEAST_OF_OBJECT = 0.15
"""Smallest fraction of the object's visible pixels that a face covers. Bands of a round object,
which have nearly equal normals, cover less."""
MOST_FACES = 3
"""Largest number of faces of a box that a camera sees at once."""
SAME_NORMAL = 0.996
"""Smallest cosine between the normals of one face (an angle of 5 degrees)."""
SAME_PLANE = 0.01
"""Largest distance of a point from the plane of its face, relative to the point's depth."""


def flat_faces(image: RenderedImage, view: View) -> Bool[np.ndarray, "row column"]:
    """Return a mask of the pixels that show a large flat face of an object.

    Args:
        image: the rendered image.
        view: the view of the image.
    """
    rows, columns = np.mgrid[: view.height, : view.width]
    rays = view.rays(np.stack([columns + 0.5, rows + 0.5], axis=-1).reshape(-1, 2))
    depth = np.where(np.isfinite(image.depth), image.depth, 0.0).ravel()
    points = view.eye + rays * (depth / (rays @ view.axes[:, 2]))[:, None]
    normals = image.normal.reshape(-1, 3)
    flat = np.zeros(depth.size, bool)
    least = LEAST_SHARE * depth.size
    for k in range(len(image.names)):
        remaining = np.flatnonzero(image.segmentation.ravel() == k)
        least_here = max(least, LEAST_OF_OBJECT * len(remaining))
        for _ in range(MOST_FACES):
            if len(remaining) < least_here:
                break
            same = normals[remaining] @ _most_common(normals[remaining]) > SAME_NORMAL
            if same.sum() < least_here:
                break
            side = remaining[same]
            normal = normals[side].mean(axis=0)
            offsets = (points[side] - points[side[0]]) @ normal
            on_plane = np.abs(offsets - np.median(offsets)) < SAME_PLANE * depth[side]
            if on_plane.sum() >= least_here:
                flat[side[on_plane]] = True
            remaining = remaining[~same]
    # Remove isolated pixels, which belong to details that lie in the plane of a face.
    return cast(Bool[np.ndarray, "row column"], ndimage.binary_opening(flat.reshape(rows.shape)))


def _most_common(normals: np.ndarray) -> np.ndarray:
    """Return the median of the normals [n, 3] in the most common bin; bins are 0.2 wide."""
    _, bins, counts = np.unique(
        np.round(5 * normals), axis=0, return_inverse=True, return_counts=True
    )
    return np.median(normals[bins.ravel() == counts.argmax()], axis=0)

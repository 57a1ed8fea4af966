"""Faces of objects that are flat where a rendered image shows them."""

from typing import cast

import numpy as np
from jaxtyping import Bool
from scipy import ndimage

from .rendering import RenderedImage
from .view import View

LEAST_SHARE = 0.004
"""Fraction of the image that a face covers at least."""
LEAST_OF_OBJECT = 0.15
"""Fraction of the object's visible pixels that a face covers at least, as bands of round objects
do not."""
MOST_FACES = 3
"""Number of faces of a box that a camera sees."""
SAME_NORMAL = 0.996
"""Cosine of the largest angle between normals of one face, 5 degrees."""
SAME_PLANE = 0.01
"""Largest distance between parallel faces that count as one, relative to the depth."""


def flat_faces(image: RenderedImage, view: View) -> Bool[np.ndarray, "row column"]:
    """Return the pixels that show a large flat face of an object.

    Args:
        image: the rendered image.
        view: its view.
    """
    rows, columns = np.mgrid[: view.height, : view.width]
    rays = view.rays(np.stack([columns + 0.5, rows + 0.5], axis=-1).reshape(-1, 2))
    depth = np.where(np.isfinite(image.depth), image.depth, 0.0).ravel()
    points = view.eye + rays * (depth / (rays @ view.axes[:, 2]))[:, None]
    normals = image.normal.reshape(-1, 3)
    flat = np.zeros(depth.size, bool)
    least = LEAST_SHARE * depth.size
    for k in range(len(image.names)):
        left = np.flatnonzero(image.segmentation.ravel() == k)
        least_here = max(least, LEAST_OF_OBJECT * len(left))
        for _ in range(MOST_FACES):
            if len(left) < least_here:
                break
            same = normals[left] @ _most_common(normals[left]) > SAME_NORMAL
            if same.sum() < least_here:
                break
            side = left[same]
            normal = normals[side].mean(axis=0)
            offsets = (points[side] - points[side[0]]) @ normal
            near = np.abs(offsets - np.median(offsets)) < SAME_PLANE * depth[side]
            if near.sum() >= least_here:
                flat[side[near]] = True
            left = left[~same]
    # A face is connected; single pixels of the same plane belong to details.
    return cast(Bool[np.ndarray, "row column"], ndimage.binary_opening(flat.reshape(rows.shape)))


def _most_common(normals: np.ndarray) -> np.ndarray:
    """Return the median [3] of the most common bin, 0.2 wide, of normals [n, 3]."""
    _, bins, counts = np.unique(
        np.round(5 * normals), axis=0, return_inverse=True, return_counts=True
    )
    return np.median(normals[bins.ravel() == counts.argmax()], axis=0)

"""Colors of the photograph near each point of a contour.

The color of a can's lid may be rare on the can, and common around it because other cans have such
lids, too. Near the lid, it is nevertheless the color inside the contour. Models of local colors
resolve such cases (Tjaden et al., "A Region-based Gauss-Newton Approach to Real-Time Monocular
Multiple Object Tracking", 2018). They assume that the contour is right to a few pixels.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from .colors import BINS, CHROMA, LIGHTNESS, LocalColors

NEAREST_PX, FARTHEST_PX = 3.0, 8.0
"""Smallest and largest distance of a sample from the contour along the normal [px]. Closer pixels
may be on the other side of the contour."""
SAMPLES = 6
"""Number of samples of a point on each side of the contour."""
POINTS = 7
"""Number of adjacent points of a contour that share their samples."""
LEAST_SAMPLES = 8
"""Least number of samples on a side; with fewer samples, the local colors are unknown."""
SPREAD = np.array([4.0, 3.0, 3.0])
"""Standard deviations of the Gaussian kernel around each sample [CIE Lab]."""
BIN_VOLUME = 100 / (BINS * LIGHTNESS) * (2 * CHROMA / BINS) ** 2
"""Volume of a histogram bin [CIE Lab^3]."""


def local_colors(
    lab: Float[np.ndarray, "row column 3"],
    mask: Bool[np.ndarray, "row column"],
    pixel: Float[np.ndarray, "n 2"],
    normal: Float[np.ndarray, "n 2"],
    colors: Float[np.ndarray, "n m 3"],
    unit: float,
) -> LocalColors:
    """Return the probabilities of colors at each point of a contour, by kernel density estimation.

    Args:
        lab: the photograph [CIE Lab].
        mask: pixels that show the object.
        pixel: points of its contour.
        normal: outward unit normals in the image.
        colors: colors whose probabilities are computed, a row for each point [CIE Lab].
        unit: number of pixels to which the constants in pixels refer.
    """
    count = min(POINTS, len(pixel))
    adjacent = KDTree(pixel).query(pixel, k=count)[1].reshape(-1, count)
    distance = np.linspace(NEAREST_PX, FARTHEST_PX, SAMPLES) * unit
    sides = []
    for sign in (-1, 1):
        spot = pixel[:, None] + sign * distance[:, None] * normal[:, None]
        sides.append(_density(lab, mask == (sign < 0), spot, adjacent, colors))
    (inside, enough_inside), (outside, enough_outside) = sides
    return LocalColors(inside, outside, enough_inside & enough_outside)


def _density(
    lab: Float[np.ndarray, "row column 3"],
    mask: Bool[np.ndarray, "row column"],
    pixel: Float[np.ndarray, "n s 2"],
    adjacent: Int[np.ndarray, "n p"],
    colors: Float[np.ndarray, "n m 3"],
) -> tuple[Float[np.ndarray, "n m"], Bool[np.ndarray, " n"]]:
    """Return the probabilities of `colors`, and whether there are enough samples in the mask."""
    column, row = np.moveaxis(np.floor(pixel).astype(int), -1, 0)
    height, width = mask.shape
    there = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    row, column = row.clip(0, height - 1), column.clip(0, width - 1)
    used = (there & mask[row, column])[adjacent].reshape(len(pixel), -1)
    samples = (lab[row, column] / SPREAD)[adjacent].reshape(len(pixel), -1, 3)
    asked = colors / SPREAD
    dot = asked @ samples.swapaxes(1, 2)
    squares = np.sum(asked**2, axis=2)[:, :, None] + np.sum(samples**2, axis=2)[:, None]
    kernel = np.exp(np.minimum(dot - squares / 2, 0.0)) * used[:, None]
    number = used.sum(axis=1)
    volume = (2 * np.pi) ** 1.5 * np.prod(SPREAD) / BIN_VOLUME
    return kernel.sum(axis=2) / (np.maximum(number, 1)[:, None] * volume), number >= LEAST_SAMPLES

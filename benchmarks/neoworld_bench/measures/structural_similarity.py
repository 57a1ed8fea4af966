"""SSIM: structural similarity of two images (Wang et al. 2004)."""

import numpy as np
from jaxtyping import UInt8
from scipy.ndimage import gaussian_filter

from neoworld_mjx.errors import PhotoError

SIGMA, RADIUS = 1.5, 5
"""Standard deviation and radius of the Gaussian window [px]; the window has 11 x 11 pixels."""
K1, K2 = 0.01, 0.03
"""Constants of equation 13 in Wang et al., relative to the range 255 of the pixels."""
LEAST_PX = 2 * RADIUS + 1


def ssim(a: UInt8[np.ndarray, "h w 3"], b: UInt8[np.ndarray, "_ _ 3"]) -> float:
    """Return the mean SSIM over pixels and color channels, which is 1 for equal images.

    Only windows that lie entirely within the image are used.

    Raises:
        PhotoError: the images differ in size, or a side is under 11 pixels.
    """
    if a.shape != b.shape or min(a.shape[:2]) < LEAST_PX:
        raise PhotoError(
            f"SSIM compares pictures of one size with sides of at least {LEAST_PX} pixels, got "
            f"{a.shape[1]} x {a.shape[0]} and {b.shape[1]} x {b.shape[0]}"
        )
    x, y = a.astype(float), b.astype(float)
    mean_x, mean_y = _blurred(x), _blurred(y)
    var_x = _blurred(x * x) - mean_x**2
    var_y = _blurred(y * y) - mean_y**2
    covariance = _blurred(x * y) - mean_x * mean_y
    c1, c2 = (255 * K1) ** 2, (255 * K2) ** 2
    structure = (2 * covariance + c2) / (var_x + var_y + c2)
    luminance = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    inner = (luminance * structure)[RADIUS:-RADIUS, RADIUS:-RADIUS]
    return float(inner.mean())


def _blurred(values: np.ndarray) -> np.ndarray:
    return gaussian_filter(values, (SIGMA, SIGMA, 0.0), radius=(RADIUS, RADIUS, 0))

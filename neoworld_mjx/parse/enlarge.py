"""Enlargement of small pictures by an integer factor; every machine gives the same pixels."""

import numpy as np
from jaxtyping import UInt8


def enlarged(rgb: UInt8[np.ndarray, "h w 3"], least: int, most: int = 8) -> np.ndarray:
    """Enlarge a picture by an integer factor until its longer side has at least `least` pixels.

    Interpolation is linear, so edges become smooth ramps without overshoot.

    Args:
        rgb: the picture [h, w, 3].
        least: minimum length of the longer side [px].
        most: maximum factor.

    Returns:
        The picture, uint8 of shape [k h, k w, 3] with an integer factor k. If the picture is large
        enough, k is 1.
    """
    factor = min(-(-least // max(rgb.shape[:2])), most)
    if factor <= 1:
        return rgb
    return _stretch(_stretch(rgb, factor, 0), factor, 1)


def _stretch(rgb: np.ndarray, factor: int, axis: int) -> np.ndarray:
    """Stretch one axis by linear interpolation between pixel centers, in integer arithmetic."""
    count = rgb.shape[axis]
    # Unit: 1 / (2 factor) pixels; origin: the center of the first pixel.
    position = 2 * np.arange(count * factor) + 1 - factor
    lower = position // (2 * factor)
    weight = position - 2 * factor * lower
    shape = [1, 1, 1]
    shape[axis] = -1
    first = np.take(rgb, np.clip(lower, 0, count - 1), axis).astype(np.int32)
    second = np.take(rgb, np.clip(lower + 1, 0, count - 1), axis).astype(np.int32)
    upper_weight = weight.reshape(shape)
    mixed = (first * (2 * factor - upper_weight) + second * upper_weight + factor) // (2 * factor)
    return mixed.astype(np.uint8)

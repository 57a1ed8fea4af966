"""Acceptance of an object's new pose, based on the pixels in which two poses differ."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_erosion

from .colors import LEAST_PIXELS, around, color_model, log_likelihood_ratio, ring_width
from .placement import Placement
from .rasterize import DrawnObjects, draw_objects, window_of
from .unknowns import Unknowns

SAME_PX = 0.5
"""Distance between two outlines [px] up to which they count as equal."""
LEAST_GAIN = 0.02
"""Least mean log likelihood ratio of the pixels in only one of two masks [nats] that counts as
evidence for a mask. The colors of neighboring pixels are correlated, so a large sum of small ratios
is no evidence."""


def shown_at(
    unknowns: Unknowns, place: Placement, drawn: DrawnObjects, k: int
) -> Bool[np.ndarray, "row column"]:
    """Return the mask of the pixels that show an object in a placement.

    The other objects occlude it as in `drawn`.
    """
    alone = draw_objects([unknowns.mesh(place, k)], place.camera, drawn.owner.shape[1])
    free = (drawn.owner == k) | (alone.depth <= drawn.depth)
    return (alone.owner == 0) & free


def is_supported(
    now: Bool[np.ndarray, "row column"],
    other: Bool[np.ndarray, "row column"],
    bins: Int[np.ndarray, "row column"],
) -> bool:
    """Return whether the photograph's colors support a mask of an object, versus another mask.

    A mask that is almost equal to the other one is supported. Arguments are as for `gain`.
    """
    ratio = _log_ratio(now, other, bins)
    return ratio is None or ratio >= LEAST_GAIN * int((now != other).sum())


def gain(
    now: Bool[np.ndarray, "row column"],
    other: Bool[np.ndarray, "row column"],
    bins: Int[np.ndarray, "row column"],
) -> float:
    """Return the log likelihood ratio of two masks of an object, given the photograph's colors.

    The object's colors are estimated from the pixels in both masks, the background's colors from
    the pixels around both masks. The pixels in only one mask are evidence for or against that mask.

    Args:
        now: the mask to be judged.
        other: the alternative mask.
        bins: index of the histogram bin of each pixel's color in the photograph.

    Returns:
        The ratio [nats], assuming independent pixels; positive if `now` explains the photograph
        better than `other`. It is 0 if the masks are almost equal, and minus infinity if too few
        pixels are in both masks or around them.
    """
    return _log_ratio(now, other, bins) or 0.0


def _log_ratio(
    now: Bool[np.ndarray, "row column"],
    other: Bool[np.ndarray, "row column"],
    bins: Int[np.ndarray, "row column"],
) -> float | None:
    """Return the value of `gain`, or None if the masks are almost equal."""
    union = now | other
    if not union.any():
        return None
    window = window_of(union, ring_width(int(union.sum())) + 2)
    now, other, union, bins = now[window], other[window], union[window], bins[window]
    outline = now & ~np.asarray(binary_erosion(now, border_value=1), bool)
    if (now != other).sum() <= SAME_PX * max(outline.sum(), 1):
        return None
    common, ring = now & other, around(union, 1)
    if min(common.sum(), ring.sum()) < LEAST_PIXELS / 2:
        return -np.inf
    ratio: Float[np.ndarray, "row column"] = log_likelihood_ratio(
        color_model(bins[common])[bins], color_model(bins[ring])[bins]
    )
    return float(ratio[now & ~other].sum() - ratio[other & ~now].sum())

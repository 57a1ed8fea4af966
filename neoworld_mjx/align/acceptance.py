"""Acceptance of an object's new place: the pixels in which two places differ decide."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_erosion

from .colors import LEAST_PIXELS, around, color_model, log_likelihood_ratio, ring_width
from .placement import Placement
from .rasterize import DrawnObjects, draw_objects, window_of
from .unknowns import Unknowns

SAME_PX = 0.5
"""Distance between two outlines [px] up to which they are the same for the photograph."""


def shown_at(
    unknowns: Unknowns, place: Placement, drawn: DrawnObjects, k: int
) -> Bool[np.ndarray, "row column"]:
    """Return the pixels that show an object at a place, among the other objects as drawn."""
    alone = draw_objects([unknowns.mesh(place, k)], place.camera, drawn.owner.shape[1])
    free = (drawn.owner == k) | (alone.depth <= drawn.depth)
    return (alone.owner == 0) & free


def gain(
    now: Bool[np.ndarray, "row column"],
    other: Bool[np.ndarray, "row column"],
    bins: Int[np.ndarray, "row column"],
) -> float:
    """Return the log likelihood ratio of two masks of an object, by its pixels' colors.

    The pixels that both masks contain say what the object's colors are, and those around both what
    the background's are. Pixels that only one contains are evidence for or against it.

    Args:
        now: the mask in question.
        other: the alternative.
        bins: bins of the photograph's colors.

    Returns:
        Positive if `now` explains the photograph better [nats, of independent pixels]; minus
        infinity if the masks hardly overlap.
    """
    union = now | other
    if not union.any():
        return 0.0
    window = window_of(union, ring_width(int(union.sum())) + 2)
    now, other, union, bins = now[window], other[window], union[window], bins[window]
    outline = now & ~np.asarray(binary_erosion(now, border_value=1), bool)
    if (now != other).sum() <= SAME_PX * max(outline.sum(), 1):
        return 0.0
    common, ring = now & other, around(union, 1)
    if min(common.sum(), ring.sum()) < LEAST_PIXELS / 2:
        return -np.inf
    ratio: Float[np.ndarray, "row column"] = log_likelihood_ratio(
        color_model(bins[common])[bins], color_model(bins[ring])[bins]
    )
    return float(ratio[now & ~other].sum() - ratio[other & ~now].sum())

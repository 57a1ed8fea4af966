"""Rows of 2D boxes: sides at which an object ends, and sides that it reaches at least."""

import numpy as np

from ...render.rasterize import DrawnObjects, pixels_of, window_of
from ...spec import Box2D
from ..unknowns import Placement, Unknowns
from .linear import REFERENCE_PX, LinearEvidence, image_jacobian

BOX_PX, BOX = 2.0, 0.01
"""Standard deviation of a side of a parsed 2D box: a constant [px], plus a share of the box's
size."""
BOX_OUTLYING = 3.0
"""Residual at which the weight of a side is halved, in standard deviations."""
END_PX = 2.5
"""Largest distance [px] between the extreme point of an object and that of its visible part at
which the object itself is assumed to end there, rather than to be occluded."""


def box_evidence(
    unknowns: Unknowns,
    now: Placement,
    neighbors: list[Placement],
    drawn: DrawnObjects,
    k: int,
    given: Box2D | None,
    *,
    soft: bool = False,
) -> LinearEvidence | None:
    """Return the evidence of an object's 2D box, or None if no side of the box is used.

    A side is used if the object itself ends there, rather than an occluder or the image. Another
    side is used as an inequality: the object reaches at least as far as its box.

    Args:
        unknowns: the unknowns.
        now: the placement, with the camera of the photograph.
        neighbors: the placements of `Unknowns.neighbors`, with the same camera.
        drawn: the objects rendered in the placement.
        k: index of the object.
        given: the box, in pixels of the photograph.
        soft: if True, a far side keeps its pull (soft L1): the object is where the response has
            it, and no contour has moved it. Otherwise, a far side is an outlier (Cauchy).
    """
    shown = drawn.owner == k
    if given is None:
        return None
    width = shown.shape[1]
    unit = width / REFERENCE_PX
    points = unknowns.surfaces[k].vertices
    pixels, depth = pixels_of(now.camera, now.world(k, points), width)
    if depth.min() <= 0:
        return None
    box = np.array(given.as_tuple()) * width / now.camera.width
    visible = np.full(4, np.inf)
    if shown.any():
        rows, columns = window_of(shown)
        visible = np.array([columns.start, rows.start, columns.stop, rows.stop])
    limit = np.array([shown.shape[1], shown.shape[0]])
    ends, normals, residuals, deviations = [], [], [], []
    for side in range(4):
        axis = side % 2
        end = int(np.argmin(pixels[:, axis]) if side < 2 else np.argmax(pixels[:, axis]))
        cut = not BOX_PX * unit < box[side] < limit[axis] - BOX_PX * unit
        hidden = cut or abs(pixels[end, axis] - visible[side]) > END_PX
        reached = pixels[end, axis] <= box[side] if side < 2 else pixels[end, axis] >= box[side]
        if hidden and reached:
            continue
        length = (box[2 + axis] - box[axis]) / unit
        ends.append(end)
        normals.append(np.eye(2)[axis])
        residuals.append((box[side] - pixels[end, axis]) / unit)
        deviations.append(BOX_PX + BOX * length)
    if not ends:
        return None
    residual, deviation = np.array(residuals), np.array(deviations)
    off = residual / deviation
    robust = 1 / np.sqrt(1 + off**2) if soft else 1 / (1 + (off / BOX_OUTLYING) ** 2)
    jacobian = image_jacobian(unknowns, now, neighbors, k, points[ends], np.array(normals), width)
    return LinearEvidence(jacobian / unit, residual, robust / deviation**2)

"""Evidence from an object's contour and 2D box, linearized in the unknowns."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .colors import LabImage, color_models
from .contours import contour, displacements
from .image_jacobian import image_jacobian
from .placement import Placement
from .rasterize import DrawnObjects, pixels_of, window_of
from .unknowns import Unknowns

REFERENCE_PX = 640.0
"""Width [px] of the image to which constants in pixels refer."""
CONTOUR_PX = 0.7
"""Standard deviation of a contour of the right shape [px]."""
SHAPE = 0.01
"""Standard deviation of a contour due to a wrong shape, relative to the contour's length / pi."""
CORRELATION_PX, OBSERVATIONS = 16.0, 30
"""Length of a contour [px] that counts as one observation, and the largest number of observations
per contour. Errors of shapes are smooth, so neighboring points are correlated."""
MARGIN_PX = 3.0
"""Width of the margin along contours that color models omit [px]."""
LEAST_SPREAD = 0.5
"""Least robust spread of the displacements of a contour [px]."""
LEAST_POINTS = 10
"""Least number of informative points for which the parts moved by a joint get a separate spread."""
LEAST_PRECISION = 1e-4
"""Precision [1/px^2] below which the colors on the two sides of a contour count as equal."""
OUTLYING = 2.0
"""Displacement at which the weight of a point is halved, in multiples of the robust spread."""
BOX_PX, BOX = 3.0, 0.01
"""Standard deviation of a side of a parsed 2D box: a constant [px], plus a share of the box's
size."""
BOX_OUTLYING = 3.0
"""Residual at which the weight of a side is halved, in standard deviations."""
END_PX = 2.5
"""Largest distance [px] between the extreme point of an object and that of its visible part at
which the object itself is assumed to end there, rather than to be occluded."""


@dataclass(frozen=True)
class LinearEvidence:
    """Linearized evidence about one object: weight * (residual - jacobian @ change)^2."""

    jacobian: Float[np.ndarray, "n v"]
    """Derivatives [px per unit] with respect to all unknowns, and then with respect to the
    stretches of `Unknowns.stretch_columns`."""
    residual: Float[np.ndarray, " n"]
    """[px]"""
    weight: Float[np.ndarray, " n"]
    """[1/px^2]"""


def contour_evidence(
    unknowns: Unknowns,
    now: Placement,
    neighbors: list[Placement],
    drawn: DrawnObjects,
    image: LabImage,
    k: int,
    *,
    reach: float,
    step: float,
    local_colors: bool = False,
) -> LinearEvidence | None:
    """Return the evidence of an object's contour, or None if there is no evidence.

    Args:
        unknowns: the unknowns.
        now: the placement.
        neighbors: the placements of `Unknowns.neighbors`.
        drawn: the objects rendered in the placement.
        image: the photograph.
        k: index of the object.
        reach: largest displacement, in pixels of an image REFERENCE_PX wide.
        step: distance between samples along normals, in pixels of an image REFERENCE_PX wide.
        local_colors: if True, the colors near each point count, too; see `displacements`.
    """
    points = contour(drawn, k)
    if points is None:
        return None
    width = image.lab.shape[1]
    unit = width / REFERENCE_PX
    models = color_models(drawn.owner, image.bins, k, max(1, round(MARGIN_PX * unit)))
    if models is None:
        return None
    length = float(points.length.sum())
    moved = displacements(
        image.lab,
        points,
        models,
        reach=reach * unit,
        step=step * unit,
        noise=float(np.hypot(CONTOUR_PX * unit, SHAPE * length / np.pi)),
        unit=unit,
        mask=drawn.owner == k if local_colors else None,
    )
    informed = moved.precision > LEAST_PRECISION / unit**2
    if not informed.any():
        return None
    body = points.body
    spread = _spreads(moved.value, informed, unknowns.mover[body], LEAST_SPREAD * unit)
    robust = 1 / (1 + (moved.value / (OUTLYING * spread)) ** 2)
    # A contour with contradictory displacements is less certain than its colors suggest.
    precision = moved.precision / (1 + moved.precision * spread**2)
    independent = max(CORRELATION_PX * unit, length / OBSERVATIONS)
    weight = points.length / independent * robust * precision
    world = _unprojected(now, points.pixel, points.depth, width)
    local = now.local(k if (body == k).all() else body, world)
    jacobian = image_jacobian(unknowns, now, neighbors, k, local, points.normal, width, body)
    return LinearEvidence(jacobian / unit, moved.value / unit, weight * unit**2)


def _spreads(
    value: Float[np.ndarray, " n"],
    informed: Bool[np.ndarray, " n"],
    mover: Int[np.ndarray, " n"],
    least: float,
) -> Float[np.ndarray, " n"]:
    """Return the robust spread of displacements at each point [px].

    A door at a wrong angle is displaced as a whole. Its points have a separate spread, so that they
    do not count as outliers. Parts with few informative points have the spread of all points.
    """
    spread = np.empty(len(value))
    few = [g for g in np.unique(mover).tolist() if informed[mover == g].sum() < LEAST_POINTS]
    mover = np.where(np.isin(mover, few), -1, mover)
    for group in np.unique(mover).tolist():
        own = np.full(len(value), True) if group == -1 else mover == group
        center = np.median(value[own])
        spread[mover == group] = 1.48 * np.median(np.abs(value - center)[informed & own])
    return np.maximum(spread, least)


def _unprojected(
    now: Placement,
    pixel: Float[np.ndarray, "n 2"],
    depth: Float[np.ndarray, " n"],
    width: int,
) -> Float[np.ndarray, "n 3"]:
    camera = now.camera
    ratio = width / camera.width
    middle = np.array([camera.width, camera.height_px]) / 2
    offset = (pixel / ratio - middle) / camera.focal
    local = np.concatenate([offset, np.ones((len(offset), 1))], axis=1) * depth[:, None]
    return camera.position() + local @ camera.axes().T


def box_evidence(
    unknowns: Unknowns,
    now: Placement,
    neighbors: list[Placement],
    drawn: DrawnObjects,
    k: int,
) -> LinearEvidence | None:
    """Return the evidence of an object's parsed 2D box, or None if no side of the box is used.

    A side is used if the object itself ends there, rather than an occluder or the image.
    """
    item = unknowns.scene.objects[k]
    shown = drawn.owner == k
    if item.box2d is None or not shown.any():
        return None
    width = shown.shape[1]
    unit = width / REFERENCE_PX
    points, bodies = unknowns.vertices(k)
    whole = (bodies == k).all()
    pixels, depth = pixels_of(now.camera, now.world(k if whole else bodies, points), width)
    if depth.min() <= 0:
        return None
    box = np.array(item.box2d.as_tuple()) * width / unknowns.camera.width
    rows, columns = window_of(shown)
    visible = columns.start, rows.start, columns.stop, rows.stop
    limit = np.array([shown.shape[1], shown.shape[0]])
    ends, normals, residuals, deviations = [], [], [], []
    for side in range(4):
        axis = side % 2
        end = int(np.argmin(pixels[:, axis]) if side < 2 else np.argmax(pixels[:, axis]))
        cut = not BOX_PX * unit < box[side] < limit[axis] - BOX_PX * unit
        if cut or abs(pixels[end, axis] - visible[side]) > END_PX:
            continue
        length = (box[2 + axis] - box[axis]) / unit
        ends.append(end)
        normals.append(np.eye(2)[axis])
        residuals.append((box[side] - pixels[end, axis]) / unit)
        deviations.append(BOX_PX + BOX * length)
    if not ends:
        return None
    residual, deviation = np.array(residuals), np.array(deviations)
    robust = 1 / (1 + (residual / (BOX_OUTLYING * deviation)) ** 2)
    jacobian = image_jacobian(
        unknowns, now, neighbors, k, points[ends], np.array(normals), width, bodies[ends]
    )
    return LinearEvidence(jacobian / unit, residual, robust / deviation**2)

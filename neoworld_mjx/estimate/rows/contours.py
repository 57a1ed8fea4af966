"""Contours of objects, and their displacements in the photograph.

Along the normal at each contour point, the colors inside the object and behind it determine the
probability of every displacement, as in M3T (Stoiber et al., "Fusing Visual Appearance and Geometry
for Multi-Modality 6DoF Object Tracking", 2023). If the outer side of an edge shows an object in
front, the edge is a contour of the object in front, and is used for that object only.

"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter, map_coordinates

from ...render.rasterize import DrawnObjects, window_of
from ..image.colors import ColorModels, LabImage, color_models, local_colors
from ..unknowns import Placement, Unknowns
from .linear import REFERENCE_PX, LinearEvidence, image_jacobian, unprojected

MOST_POINTS = 300
"""Largest number of points of a contour."""
NORMAL_BLUR_PX = 1.5
"""Standard deviation of the Gaussian that smooths a mask before its normals are computed [px]."""
REACH_PX = 4
"""Width of the margin around a mask in which its smoothed gradient is computed [px]."""
LEAST_GRADIENT = 0.02
"""Gradient of the smoothed mask below which the normal is undefined, as on a thin line."""
BORDER_PX = 3.0
"""Distance from the border of the image within which contours are ignored [px]."""
SPREAD = 1.5
"""Ratio of the largest displacement to the standard deviation of the prior of displacements."""


class Contour(NamedTuple):
    """Points on the visible contour of an object where the object is in front."""

    pixel: Float[np.ndarray, "n 2"]
    depth: Float[np.ndarray, " n"]
    """Depth of the object along the view [m]."""
    normal: Float[np.ndarray, "n 2"]
    """Outward unit normal in the image."""
    behind: Int[np.ndarray, " n"]
    """Index of the object behind the contour; -1 for none."""
    length: Float[np.ndarray, " n"]
    """Length of the contour that each point represents [px]."""


class Displacements(NamedTuple):
    """Displacements of contour points along their normals, estimated from the pixels."""

    value: Float[np.ndarray, " n"]
    """Displacement [px], positive outward."""
    precision: Float[np.ndarray, " n"]
    """Precision [1/px^2]; 0 if the colors do not distinguish the two sides."""


def contour(drawn: DrawnObjects, k: int) -> Contour | None:
    """Return evenly spaced points of an object's contour, or None if no contour is visible."""
    mask = drawn.owner == k
    if not mask.any():
        return None
    height, width = mask.shape
    window = window_of(mask, REACH_PX)
    top, left = (span.start for span in window)
    owner, depth = drawn.owner[window], drawn.depth[window]
    smooth = gaussian_filter((owner == k).astype(float), NORMAL_BLUR_PX, mode="nearest")
    down, right = np.gradient(smooth)
    gradient = np.stack([right, down], axis=-1)
    found = []
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        here = _shifted(owner.shape, -dx, -dy)
        there = _shifted(owner.shape, dx, dy)
        edge = (owner[here] == k) & (owner[there] != k) & (depth[here] <= depth[there])
        y, x = np.nonzero(edge)
        behind = owner[there][y, x]
        y, x = y + here[0].start, x + here[1].start
        pixel = np.stack([x + left + 0.5 + 0.5 * dx, y + top + 0.5 + 0.5 * dy], axis=1)
        found.append((pixel, depth[y, x], -gradient[y, x], behind))
    pixel, depth, slope, behind = (np.concatenate(part) for part in zip(*found, strict=True))
    steep = np.linalg.norm(slope, axis=1)
    inner = (pixel > BORDER_PX) & (pixel < np.array([width, height]) - BORDER_PX)
    rows = np.flatnonzero((steep > LEAST_GRADIENT) & inner.all(axis=1))
    if not len(rows):
        return None
    share = max(len(rows) / MOST_POINTS, 1.0)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MOST_POINTS)).astype(int)]
    normal = slope[rows] / steep[rows, None]
    # A path along the pixel grid is longer than the contour.
    length = share / np.abs(normal).sum(axis=1)
    return Contour(pixel[rows], depth[rows], normal, behind[rows], length)


def _shifted(shape: tuple[int, ...], dx: int, dy: int) -> tuple[slice, slice]:
    rows, columns = shape
    return (
        slice(max(0, dy), rows + min(0, dy)),
        slice(max(0, dx), columns + min(0, dx)),
    )


MASK_NATS = 2.0
"""Log likelihood ratio of a pixel inside and outside of a known mask [nats]."""


def displacements(
    lab: Float[np.ndarray, "row column 3"],
    points: Contour,
    models: ColorModels | None,
    *,
    reach: float,
    step: float,
    noise: float,
    unit: float,
    mask: Bool[np.ndarray, "row column"] | None = None,
    known: Bool[np.ndarray, "row column"] | None = None,
) -> Displacements:
    """Return the displacement of each contour point.

    Args:
        lab: the photograph [CIE Lab].
        points: points of a contour.
        models: color models of the two sides; None if `known` is given.
        reach: largest displacement [px].
        step: distance between samples along a normal [px].
        noise: standard deviation of a contour with perfect color evidence [px], because shapes are
            approximate.
        unit: number of pixels that count as one independent observation of a color.
        mask: pixels that show the object. If given, the colors near each point count, too; then the
            contour must be right to a few pixels.
        known: pixels that show the object in the photograph, which replace the colors.
    """
    offset = np.arange(-reach, reach + step / 2, step)
    spot = points.pixel[:, None] + offset[None, :, None] * points.normal[:, None] - 0.5
    at = [spot[..., 1], spot[..., 0]]
    if known is not None or models is None:
        assert known is not None
        share = map_coordinates(known.astype(float), at, order=1, mode="nearest")
        ratio = MASK_NATS * (2 * share - 1) * (step / unit)
    else:
        sampled = [map_coordinates(lab[..., c], at, order=1, mode="nearest") for c in range(3)]
        colors, near = np.stack(sampled, axis=-1), None
        if mask is not None:
            near = local_colors(lab, mask, points.pixel, points.normal, colors, unit)
        ratio = models.log_ratio(colors, points.behind, near) * (step / unit)
    # If the contour is between two samples, all samples on its inner side show the object.
    likelihood = np.concatenate([np.zeros((len(ratio), 1)), np.cumsum(ratio, axis=1)], axis=1)
    edge = np.append(offset - step / 2, offset[-1] + step / 2)
    prior = -0.5 * (edge * SPREAD / reach) ** 2
    mean, variance = _moments(likelihood + prior, edge)
    prior_variance = _moments(prior[None], edge)[1]
    # The precision due to the pixels alone, and the displacement without the effect of the prior.
    gain = np.maximum(1 / np.maximum(variance, 1e-6) - 1 / prior_variance, 1e-3 / prior_variance)
    value = np.clip(mean / np.maximum(variance, 1e-6) / gain, -reach, reach)
    precision = 1 / (variance + noise**2) - 1 / (prior_variance + noise**2)
    return Displacements(value, np.maximum(precision, 0.0))


def _moments(
    log_p: Float[np.ndarray, "n m"], offset: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    p = np.exp(log_p - log_p.max(axis=1, keepdims=True))
    p /= p.sum(axis=1, keepdims=True)
    mean = p @ offset
    return mean, np.maximum(p @ offset**2 - mean**2, 0.0)


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
LEAST_PRECISION = 1e-4
"""Precision [1/px^2] below which the colors on the two sides of a contour count as equal."""
OUTLYING = 2.0
"""Displacement at which the weight of a point is halved, in multiples of the robust spread."""


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
    known: Bool[np.ndarray, "row column"] | None = None,
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
        known: pixels that show the object in the photograph, which replace the colors.
    """
    points = contour(drawn, k)
    if points is None:
        return None
    width = image.lab.shape[1]
    unit = width / REFERENCE_PX
    models = None
    if known is None:
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
        known=known,
    )
    informed = moved.precision > LEAST_PRECISION / unit**2
    if not informed.any():
        return None
    deviation = np.abs(moved.value - np.median(moved.value))[informed]
    spread = np.maximum(1.48 * np.median(deviation), LEAST_SPREAD * unit)
    robust = 1 / (1 + (moved.value / (OUTLYING * spread)) ** 2)
    # A contour with contradictory displacements is less certain than its colors suggest.
    precision = moved.precision / (1 + moved.precision * np.square(spread))
    independent = max(CORRELATION_PX * unit, length / OBSERVATIONS)
    weight = points.length / independent * robust * precision
    world = unprojected(now, points.pixel, points.depth, width)
    local = now.local(k, world)
    jacobian = image_jacobian(unknowns, now, neighbors, k, local, points.normal, width)
    return LinearEvidence(jacobian / unit, moved.value / unit, weight * unit**2)

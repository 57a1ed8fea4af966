"""Normal equations of the alignment: evidence of contours and of 2D boxes by object; contacts."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .colors import ColorModels, FaceColors, LabImage, color_models
from .contacts import ContactGaps
from .contours import Contour, contour, displacements
from .creases import creases
from .rasterize import DrawnObjects, pixels_of, window_of
from .shape_evidence import ShapeEvidence
from .unknowns import STRETCH, Placement, Unknowns

REFERENCE_PX = 640.0
"""Width of the image in which the constants in pixels are given."""
CONTOUR_PX = 0.7
"""Standard deviation of a contour of the right shape."""
SHAPE = 0.01
"""Standard deviation of a contour due to its shape, over its length / pi."""
CORRELATION_PX, OBSERVATIONS = 16.0, 30
"""Length of a contour that counts as one observation, and the largest number of observations of a
contour: errors of shapes are smooth."""
MARGIN_PX = 3.0
"""Margin along contours that color models leave out [px]."""
LEAST_SPREAD = 0.5
"""Least robust spread of the displacements of a contour [px]."""
LEAST_POINTS = 10
"""Number of informed points from which what a joint moves has a spread of its own."""
LEAST_PRECISION = 1e-4
"""Precision [1/px^2] below which the colors of a contour's two sides are the same."""
OUTLYING = 2.0
"""Displacement, in robust spreads, at which a point has half of its weight."""
BOX_PX, BOX = 3.0, 0.01
"""Standard deviation of a side of a parsed 2D box: pixels, and a share of the box."""
BOX_OUTLYING = 3.0
"""Residual of a side, in deviations, at which it has half of its weight."""
END_PX = 2.5
"""Largest distance between the extreme point of an object and that of its visible part at which the
object itself ends there."""
OVERLAP_M = 0.002
"""Standard deviation of the overlap of two objects [m]."""
DEEP_M = 0.005
"""Overlap at which a contact has half of its weight [m]: a deeper one is rather a wrong shape."""
GIVEN = 1e18
"""Precision of an unknown that is given."""
ACTIVE_SETS = 10
"""Largest number of times that contacts are added to those that a step would violate."""


@dataclass(frozen=True)
class Evidence:
    """Linearized evidence about one object: weight * (residual - jacobian @ change)^2."""

    jacobian: Float[np.ndarray, "n v"]
    """Derivatives by all unknowns, and by the stretches of `stretch_columns` [px]."""
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
    with_creases: bool = True,
) -> Evidence | None:
    """Return the evidence of an object's contour and creases, or None without a contour.

    Args:
        unknowns: the unknowns.
        now: the placement.
        neighbors: of `Unknowns.neighbors`.
        drawn: the objects at the placement.
        image: the photograph.
        k: index of the object.
        reach: largest displacement, in pixels of REFERENCE_PX.
        step: distance of the samples along normals, in the same unit.
        with_creases: whether creases count, too.
    """
    points = contour(drawn, k)
    if points is None:
        return None
    width = image.lab.shape[1]
    unit = width / REFERENCE_PX
    margin = max(1, round(MARGIN_PX * unit))
    models = color_models(drawn.owner, image.bins, k, margin)
    if models is None:
        return None
    length = float(points.length.sum())
    lines: list[tuple[Contour, ColorModels | FaceColors]] = [(points, models)]
    if with_creases:
        lines += creases(drawn, image.lab, k, margin)
    located = [
        _located(*line, image, length, unknowns.mover, reach=reach, step=step) for line in lines
    ]
    if not any(part is not None for part in located):
        return None
    pixel, depth, normal, body, value, weight = (
        np.concatenate(values) for values in zip(*filter(None, located), strict=True)
    )
    world = _unprojected(now, pixel, depth, width)
    local = now.local(k if (body == k).all() else body, world)
    jacobian = unknowns.jacobian(now, neighbors, k, local, normal, width, body)
    return Evidence(jacobian / unit, value / unit, weight * unit**2)


class _Located(NamedTuple):
    """Points of a contour or crease with their displacements in the photograph."""

    pixel: Float[np.ndarray, "n 2"]
    depth: Float[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 2"]
    body: Int[np.ndarray, " n"]
    """Body that shows there, see `open_joints`."""
    value: Float[np.ndarray, " n"]
    """Displacement along the normal [px]."""
    weight: Float[np.ndarray, " n"]
    """[1/px^2]"""


def _located(
    points: Contour,
    models: ColorModels | FaceColors,
    image: LabImage,
    length: float,
    mover: Int[np.ndarray, " body"],
    *,
    reach: float,
    step: float,
) -> _Located | None:
    """Locate a contour or crease of an object in the photograph; None if colors do not show it.

    Args:
        points: its points.
        models: colors on its two sides.
        image: the photograph.
        length: length of the object's contour [px].
        mover: what moves each body, as `Unknowns.mover`.
        reach: as for `contour_evidence`.
        step: as for `contour_evidence`.
    """
    unit = image.lab.shape[1] / REFERENCE_PX
    noise = float(np.hypot(CONTOUR_PX * unit, SHAPE * length / np.pi))
    moved = displacements(
        image.lab,
        points,
        models,
        reach=reach * unit,
        step=step * unit,
        noise=noise,
        unit=unit,
    )
    informed = moved.precision > LEAST_PRECISION / unit**2
    if not informed.any():
        return None
    spread = _spreads(moved.value, informed, mover[points.body], LEAST_SPREAD * unit)
    robust = 1 / (1 + (moved.value / (OUTLYING * spread)) ** 2)
    # A contour that disagrees with itself is less certain than its colors say.
    precision = moved.precision / (1 + moved.precision * spread**2)
    independent = max(CORRELATION_PX * unit, length / OBSERVATIONS)
    weight = points.length / independent * robust * precision
    return _Located(points.pixel, points.depth, points.normal, points.body, moved.value, weight)


def _spreads(
    value: Float[np.ndarray, " n"],
    informed: Bool[np.ndarray, " n"],
    mover: Int[np.ndarray, " n"],
    least: float,
) -> Float[np.ndarray, " n"]:
    """Return the robust spread of displacements at each point [px].

    A door at a wrong angle is displaced as a whole and has a spread of its own, so that it is no
    outlier; what has few informed points shares that of all.
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
) -> Evidence | None:
    """Return the evidence of the sides of an object's parsed 2D box at which the object ends."""
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
    jacobian = unknowns.jacobian(
        now, neighbors, k, points[ends], np.array(normals), width, bodies[ends]
    )
    return Evidence(jacobian / unit, residual, robust / deviation**2)


class NormalEquations:
    """Normal equations of the unknowns and of all stretches, with the contours kept by object."""

    def __init__(
        self, unknowns: Unknowns, prior: Float[np.ndarray, "v v"], x: Float[np.ndarray, " u"]
    ):
        """Start from the prior's precision matrix, at some values of the unknowns."""
        self._unknowns, self._x = unknowns, x
        self._prior, self._precision = prior, prior.copy()
        self._gradient = -prior[:, : unknowns.size] @ x
        self._contours: dict[int, _Block] = {}
        self._boxes: set[int] = set()
        self._contacts = ContactGaps(np.zeros(0), np.zeros((0, len(prior))))

    def add_box(self, k: int, evidence: Evidence) -> None:
        """Add the evidence of an object's 2D box."""
        self._boxes.add(k)
        self._add(self._block(k, evidence), 1.0, self._precision, self._gradient)

    def add_contacts(self, contacts: ContactGaps) -> None:
        """Add the gaps between objects, which `solved` keeps from closing."""
        self._contacts = contacts

    def add_contour(self, k: int, evidence: Evidence) -> None:
        """Add the evidence of an object's contour, which `solved` may omit."""
        self._contours[k] = self._block(k, evidence)
        self._add(self._contours[k], 1.0, self._precision, self._gradient)

    @property
    def with_contour(self) -> tuple[int, ...]:
        """Indices of the objects with evidence of a contour."""
        return tuple(self._contours)

    @property
    def with_box(self) -> frozenset[int]:
        """Indices of the objects with evidence of a 2D box."""
        return frozenset(self._boxes)

    def solved(
        self, without: Collection[int] = (), held: Mapping[int, float] | None = None
    ) -> Float[np.ndarray, " u"]:
        """Return new values of the unknowns, in which joints are within their limits.

        Args:
            without: objects whose contours do not count.
            held: values of unknowns that are given, by index.
        """
        precision, gradient = self._precision.copy(), self._gradient.copy()
        for k in without:
            self._add(self._contours[k], -1.0, precision, gradient)
        fixed = dict(held or {})
        first = self._unknowns.first_joint
        while True:
            x = self._x + self._separated(*self._fixed(precision, gradient, fixed))[: len(self._x)]
            x[list(fixed)] = list(fixed.values())
            limits = {
                first + j: limit
                for j, joint in enumerate(self._unknowns.joints)
                if (limit := joint.limit_beyond(x[first + j])) is not None
            }
            if not limits:
                return x
            fixed |= limits

    def _fixed(
        self, precision: np.ndarray, gradient: np.ndarray, values: Mapping[int, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the equations with some unknowns at given values."""
        if not values:
            return precision, gradient
        columns = list(values)
        precision, gradient = precision.copy(), gradient.copy()
        precision[columns, columns] += GIVEN
        gradient[columns] += GIVEN * (np.array(list(values.values())) - self._x[columns])
        return precision, gradient

    def _separated(self, precision: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Return the step in which a penalty acts on every gap that would be negative."""
        step = np.linalg.solve(precision, gradient)
        gap, jacobian = self._contacts
        weight = 1 / (OVERLAP_M**2 * (1 + (np.minimum(gap, 0.0) / DEEP_M) ** 2))
        violated = np.zeros(len(gap), bool)
        for _ in range(ACTIVE_SETS):
            more = (gap + jacobian @ step < 0) & ~violated
            if not more.any():
                break
            violated |= more
            rows = jacobian[violated]
            weighted = rows.T * weight[violated]
            step = np.linalg.solve(precision + weighted @ rows, gradient - weighted @ gap[violated])
        return step

    def covariance(self) -> Float[np.ndarray, "u u"]:
        """Return the covariance of the unknowns, in which contacts do not count."""
        return np.linalg.inv(self._precision)[: len(self._x), : len(self._x)]

    def shape_evidence(self) -> dict[int, ShapeEvidence]:
        """Return what contours and 2D boxes say about the stretches of each object with a contour.

        All other unknowns are marginalized; contacts do not count.
        """
        covariance = np.linalg.inv(self._precision)
        estimate = covariance @ self._gradient
        found = {}
        for k in self.with_contour:
            # The first are those of the object itself, not of what its joints move.
            rows = np.array(self._unknowns.stretch_columns(k)[:STRETCH])
            block = np.ix_(rows, rows)
            precision = np.linalg.inv(covariance[block])
            found[k] = ShapeEvidence(
                precision - self._prior[block],
                precision @ estimate[rows],
                covariance[: len(self._x), rows] @ precision,
                estimate[rows],
            )
        return found

    def _block(self, k: int, evidence: Evidence) -> "_Block":
        size = len(self._x)
        used = np.flatnonzero((evidence.jacobian[:, :size] != 0).any(axis=0))
        stretches = self._unknowns.stretch_columns(k)
        rows = np.concatenate([used, stretches])
        jacobian = evidence.jacobian[:, np.concatenate([used, size + np.arange(len(stretches))])]
        weighted = jacobian * evidence.weight[:, None]
        return _Block(rows, jacobian.T @ weighted, weighted.T @ evidence.residual)

    @staticmethod
    def _add(block: "_Block", sign: float, precision: np.ndarray, gradient: np.ndarray) -> None:
        precision[np.ix_(block.rows, block.rows)] += sign * block.precision
        gradient[block.rows] += sign * block.gradient


class _Block(NamedTuple):
    rows: Int[np.ndarray, " r"]
    precision: Float[np.ndarray, "r r"]
    gradient: Float[np.ndarray, " r"]

"""Normal equations of the alignment: linearized contours, boxes, contacts and prior.

Derivatives of image points with respect to the alignment's unknowns, by finite differences.

Evidence from an object's contour and 2D box, linearized in the unknowns.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..spec import Box2D, Camera
from .colors import LabImage, color_models
from .contacts import ContactGaps
from .contours import contour, displacements
from .rasterize import DrawnObjects, pixels_of, window_of
from .unknowns import CAMERA, STEP, STRETCH, Placement, Unknowns


def image_jacobian(
    unknowns: Unknowns,
    now: Placement,
    neighbors: list[Placement],
    k: int,
    points: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 2"],
    width: int,
) -> Float[np.ndarray, "n v"]:
    """Return the derivatives of image points along normals with respect to the unknowns.

    Args:
        unknowns: the unknowns.
        now: the placement.
        neighbors: the placements of `Unknowns.neighbors`, at the same values of the unknowns.
        k: index of the object.
        points: points in the object's frame [m].
        normal: unit vectors in the image, one for each point.
        width: width of the image [px].

    Returns:
        The derivatives [px per unit] with respect to all unknowns, and then with respect to the
        stretches of `Unknowns.stretch_columns`.
    """
    along = lambda p, camera: np.sum(pixels_of(camera, p, width)[0] * normal, axis=1)
    return value_jacobian(unknowns, now, neighbors, k, points, along)


def value_jacobian(
    unknowns: Unknowns,
    now: Placement,
    neighbors: list[Placement],
    k: int,
    points: Float[np.ndarray, "n 3"],
    along: Callable[[Float[np.ndarray, "n 3"], Camera], Float[np.ndarray, " n"]],
) -> Float[np.ndarray, "n v"]:
    """Return the derivatives of a value of each point with respect to the unknowns.

    Arguments and columns are as for `image_jacobian`; `along` maps points in the world and the
    camera to the values.
    """
    start = along(now.world(k, points), now.camera)
    result = np.zeros((len(points), unknowns.size + STRETCH))
    for u in [*range(CAMERA), *unknowns.columns_of(k), *unknowns.view_columns(now.view)]:
        near = neighbors[u]
        result[:, u] = (along(near.world(k, points), near.camera) - start) / STEP
    foot = unknowns.lowest[k] * now.turn[k][2]
    for axis in range(STRETCH):
        stretched = points.copy()
        stretched[:, axis] += STEP * (points - foot)[:, axis]
        moved = along(now.world(k, stretched), now.camera)
        result[:, unknowns.size + axis] = (moved - start) / STEP
    return result


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
    """Linearized evidence about one object: weight * (residual - jacobian @ change)^2.

    Residuals are in pixels or, for depths, in meters.
    """

    jacobian: Float[np.ndarray, "n v"]
    """Derivatives [px per unit] with respect to all unknowns, and then with respect to the
    stretches of `Unknowns.stretch_columns`."""
    residual: Float[np.ndarray, " n"]
    """[px]"""
    weight: Float[np.ndarray, " n"]
    """[1/px^2]"""
    global_jacobian: Float[np.ndarray, "n g"] | None = None
    """Derivatives with respect to the scale and shift of the depth image; None if the residuals do
    not depend on them."""


def combined(evidence: Sequence[LinearEvidence]) -> LinearEvidence:
    """Return the evidence of several photographs about one object as one."""
    if len(evidence) == 1:
        return evidence[0]
    parts = ([getattr(e, name) for e in evidence] for name in ("jacobian", "residual", "weight"))
    return LinearEvidence(*(np.concatenate(part) for part in parts))


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


def unprojected(
    now: Placement,
    pixel: Float[np.ndarray, "n 2"],
    depth: Float[np.ndarray, " n"],
    width: int,
) -> Float[np.ndarray, "n 3"]:
    """Return the points in the world at some pixels of an image `width` pixels wide [m].

    Args:
        now: the placement, for its camera.
        pixel: pixels of the image.
        depth: depths along the view [m].
        width: width of the image [px].
    """
    camera = now.camera
    ratio = width / camera.width
    offset = (pixel / ratio - camera.center) / camera.focal
    local = np.concatenate([offset, np.ones((len(offset), 1))], axis=1) * depth[:, None]
    return camera.position() + local @ camera.axes().T


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


GIVEN = 1e18
"""Precision of an unknown whose value is given."""
ACTIVE_SETS = 10
"""Largest number of updates of the active set, the contacts that a step would violate."""


GLOBAL_PRECISION = 1e-6
"""Prior precision of the scale and shift of a depth image, which its own rows determine."""
Source = Literal["contour", "depth"]
"""Evidence that `NormalEquations.solved` can omit."""


class NormalEquations:
    """Normal equations of the unknowns, of all stretches, and of a depth image's scale and shift.

    The evidence of contours and depths is stored by object, so that `solved` can omit it.
    """

    def __init__(
        self,
        unknowns: Unknowns,
        prior: Float[np.ndarray, "v v"],
        x: Float[np.ndarray, " u"],
        *,
        mean: Float[np.ndarray, " u"],
        global_count: int = 0,
    ):
        """Start from the prior's precision matrix, at the values `x` of the unknowns.

        Args:
            unknowns: the unknowns.
            prior: precision of all unknowns and stretches.
            x: values of the unknowns.
            mean: mean of the prior.
            global_count: number of unknowns of the depth image, which follow the stretches.
        """
        self._unknowns, self._x = unknowns, x
        if global_count:
            prior = np.pad(prior, (0, global_count))
            ends = np.arange(len(prior) - global_count, len(prior))
            prior[ends, ends] = GLOBAL_PRECISION
        self._prior, self._precision = prior, prior.copy()
        self._gradient = -prior[:, : unknowns.size] @ (x - mean)
        self._blocks: dict[Source, dict[int, _Block]] = {"contour": {}, "depth": {}}
        self._boxes: set[int] = set()
        self._contacts = ContactGaps(np.zeros(0), np.zeros((0, len(prior))), np.zeros(0))

    def add_box(self, k: int, evidence: LinearEvidence) -> None:
        """Add the evidence of an object's 2D box."""
        self._boxes.add(k)
        self._add(self._block(k, evidence), 1.0, self._precision, self._gradient)

    def add_camera(
        self, residual: Float[np.ndarray, " n"], jacobian: Float[np.ndarray, "n 4"]
    ) -> None:
        """Add evidence about the camera; residuals and Jacobian are in standard deviations."""
        camera = np.arange(jacobian.shape[1])
        block = _Block(camera, jacobian.T @ jacobian, jacobian.T @ residual)
        self._add(block, 1.0, self._precision, self._gradient)

    def add_contacts(self, contacts: ContactGaps) -> None:
        """Set the gaps between objects; `solved` penalizes steps that would make a gap negative."""
        more = len(self._prior) - contacts.jacobian.shape[1]
        if more:
            contacts = contacts._replace(jacobian=np.pad(contacts.jacobian, ((0, 0), (0, more))))
        self._contacts = contacts

    def add_contour(self, k: int, evidence: LinearEvidence) -> None:
        """Add the evidence of an object's contour, which `solved` can omit."""
        self._add_source("contour", k, evidence)

    def add_depth(self, k: int, evidence: LinearEvidence) -> None:
        """Add the evidence of an object's depth, which `solved` can omit if the object is free."""
        self._add_source("depth", k, evidence)

    def _add_source(self, source: Source, k: int, evidence: LinearEvidence) -> None:
        block = self._blocks[source][k] = self._block(k, evidence)
        self._add(block, 1.0, self._precision, self._gradient)

    @property
    def with_contour(self) -> tuple[int, ...]:
        """Indices of the objects with contour evidence."""
        return tuple(self._blocks["contour"])

    @property
    def with_depth(self) -> tuple[int, ...]:
        """Indices of the objects with depth evidence, fixed supports included."""
        return tuple(self._blocks["depth"])

    @property
    def with_box(self) -> frozenset[int]:
        """Indices of the objects whose 2D boxes were added as evidence."""
        return frozenset(self._boxes)

    def solved(
        self, without: Collection[int] = (), *, source: Source = "contour"
    ) -> Float[np.ndarray, " u"]:
        """Return new values of the unknowns; known values stay 0.

        Args:
            without: indices of the objects whose evidence is omitted.
            source: which evidence of these objects is omitted.
        """
        precision, gradient = self._precision.copy(), self._gradient.copy()
        for k in without:
            self._add(self._blocks[source][k], -1.0, precision, gradient)
        known = list(self._unknowns.known)
        precision[known, known] += GIVEN
        gradient[known] -= GIVEN * self._x[known]
        x = self._x + self._separated(precision, gradient)[: len(self._x)]
        x[known] = 0.0
        return x

    def _separated(self, precision: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Return the solution with a penalty on every gap that would otherwise be negative."""
        step = np.linalg.solve(precision, gradient)
        gap, jacobian, weight = self._contacts
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
        """Return the covariance of the unknowns; contacts are ignored."""
        return np.linalg.inv(self._precision)[: len(self._x), : len(self._x)]

    def _block(self, k: int, evidence: LinearEvidence) -> "_Block":
        size = len(self._x)
        used = np.flatnonzero((evidence.jacobian[:, :size] != 0).any(axis=0))
        stretches = self._unknowns.stretch_columns(k) if k in self._unknowns.free else []
        rows = np.concatenate([used, stretches]).astype(int)
        jacobian = evidence.jacobian[:, np.concatenate([used, size + np.arange(len(stretches))])]
        if evidence.global_jacobian is not None:
            count = evidence.global_jacobian.shape[1]
            rows = np.append(rows, np.arange(len(self._prior) - count, len(self._prior)))
            jacobian = np.concatenate([jacobian, evidence.global_jacobian], axis=1)
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

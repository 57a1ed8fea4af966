"""Candidate changes of one dimension of a program, rated by the pixels of the photograph."""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..align.acceptance import gain
from ..align.alignment import FittedUnknowns
from ..align.rasterize import DrawnObjects, WorldMesh, draw_objects
from ..align.shape_evidence import ShapeEvidence
from ..spec import ObjectSpec, bounds
from .named_constants import NamedConstant, named_constants, with_value

PROBE_STEP = 0.01
"""Relative change of a constant for the finite differences of `sensitivities`."""
MIN_SENSITIVITY = 0.05
"""A constant changes proportions if it changes the ratio of two edges by more than this.

The value is the derivative of the logarithm of the ratio by the logarithm of the constant.
"""
EQUAL_EDGES = 0.01
"""Largest difference between the logarithms of two edges that count as equal."""
MIN_DEVIATIONS, MIN_CHANGE = 1.0, 0.03
"""A stretch along an axis is significant if it exceeds both limits.

The first limit is in standard deviations, the second is relative. The second limit is also the
smallest change of a constant that is tried.
"""
MIN_STEP = 0.01
"""Smallest relative change that is tried of a constant that was changed before."""
MAX_LOG_CHANGE = math.log(1.25)
"""Largest total change of the logarithm of a constant."""
STEP_FACTORS = (0.5, 1.0, 1.5, 2.0)
"""Multiples of the estimated change that are rated by the pixels.

They include larger changes, because the prior and the nuisance parameters shrink the estimate.
"""

Build = Callable[[str], ObjectSpec | str]
"""Builds the object of a program's text; if it cannot be built, returns the reason."""


@dataclass(frozen=True)
class Candidate:
    """A change of a constant."""

    constant: NamedConstant
    value: float
    gain: float
    """Log likelihood ratio of the outline after the change to the outline before it [nats].

    The ratio treats pixels as independent.
    """


@dataclass(frozen=True)
class Contours:
    """An aligned scene, rendered over the photograph."""

    fitted: FittedUnknowns
    rendered: DrawnObjects
    bins: Int[np.ndarray, "row column"]
    """Index of the color bin of each pixel of the photograph."""
    outlines: Mapping[str, float | None]
    """Error of each object's outline [px], by name; see `outline_errors`."""

    def stretched(
        self, k: int, stretches: Float[np.ndarray, " 3"]
    ) -> Bool[np.ndarray, "row column"]:
        """Return the mask of the pixels that show a stretched object at its most probable pose.

        Args:
            k: index of the object.
            stretches: logarithms of the stretch factors along the object's axes.
        """
        unknowns, shape = self.fitted.unknowns, self.fitted.shapes[k]
        x = self.fitted.x + shape.response @ (stretches - shape.discarded)
        place = unknowns.place(x[None])[0]
        surface = unknowns.surfaces[k]
        foot = unknowns.lowest[k] * place.turn[k][2]
        points = foot + (surface.vertices - foot) * np.exp(stretches)
        mesh = WorldMesh(place.world(k, points), surface.triangles)
        alone = draw_objects([mesh], place.camera, self.rendered.owner.shape[1])
        free = (self.rendered.owner == k) | (alone.depth <= self.rendered.depth)
        return (alone.owner == 0) & free


def best_candidate(
    contours: Contours,
    k: int,
    text: str,
    build: Build,
    original: dict[str, float],
    *,
    refused: Collection[str] = (),
    changed: str = "",
) -> Candidate | None:
    """Return the change of one constant whose outline explains the photograph best.

    Args:
        contours: the aligned scene.
        k: index of the object.
        text: the object's program.
        build: builds the object.
        original: values of the constants before all changes.
        refused: names of constants that must not change.
        changed: name of the only constant that may change, which was changed before. If empty,
            any constant may change.

    Returns:
        The candidate, or None if no change is large enough.
    """
    shape = contours.fitted.shapes[k]
    if not changed and not significant(shape):
        return None
    current, best = contours.rendered.owner == k, None
    for constant, direction in sensitivities(text, build):
        if constant.name in refused or changed not in ("", constant.name):
            continue
        change = shape.change(direction)
        min_step = MIN_STEP if changed else MIN_CHANGE
        for factor in STEP_FACTORS:
            value = _bounded(constant, factor * change.log_change, original[constant.name])
            step = math.log(value / constant.value)
            if abs(step) < min_step:
                continue
            log_ratio = gain(contours.stretched(k, step * direction), current, contours.bins)
            if best is None or log_ratio > best.gain:
                best = Candidate(constant, value, log_ratio)
    return best


def _bounded(constant: NamedConstant, log_change: float, original: float) -> float:
    change = math.log(constant.value / original) + log_change
    return constant.within(original * math.exp(min(max(change, -MAX_LOG_CHANGE), MAX_LOG_CHANGE)))


def significant(shape: ShapeEvidence) -> bool:
    """Return True if the contour shows that an object is too long or too short along an axis."""
    changes = (shape.change(np.eye(3)[axis] - 1 / 3) for axis in range(3))
    return any(
        abs(change.log_change) > max(MIN_CHANGE, MIN_DEVIATIONS * change.deviation)
        for change in changes
    )


def sensitivities(text: str, build: Build) -> list[tuple[NamedConstant, Float[np.ndarray, " 3"]]]:
    """Return the constants of a program that change its object's proportions.

    Constants that would make equal edges unequal are omitted, so that a round or square object
    remains round or square.

    Returns:
        Each constant with three derivatives: those of the logarithms of the object's edges along x,
        y and z with respect to the logarithm of the constant. The mean of the three is subtracted,
        because composition undoes a uniform scaling.
    """
    original = build(text)
    if isinstance(original, str):
        return []
    edges, results = _log_edges(original), []
    equal = np.abs(edges[:, None] - edges) < EQUAL_EDGES
    for constant in named_constants(text):
        probed = with_value(text, constant, constant.value * (1 + PROBE_STEP))
        changed = build(probed)
        if isinstance(changed, str):
            continue
        value = next(c.value for c in named_constants(probed) if c.name == constant.name)
        direction = (_log_edges(changed) - edges) / math.log(value / constant.value)
        differences = np.abs(direction[:, None] - direction)
        if differences.max() > MIN_SENSITIVITY and differences[equal].max() < MIN_SENSITIVITY:
            results.append((constant, direction - direction.mean()))
    return results


def _log_edges(spec: ObjectSpec) -> Float[np.ndarray, " 3"]:
    low, high = bounds(spec)
    return np.log(np.maximum(high - low, 1e-9))

"""Named constants of a program, and edits of one number in the program's text.

A program assigns its dimensions to names at top level, as the guide for programmers asks. Examples
are `X, Y, Z = 0.60, 0.90, 0.45`, and `depth = 0.55  # 0.4 to 0.7 m` in a template. An edit replaces
only the literal.

`best_candidate` rates changes of one constant by the pixels of the photograph.
"""

import ast
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..estimate.alignment import FittedUnknowns
from ..estimate.colors import gain
from ..estimate.contours import ShapeEvidence
from ..estimate.rasterize import DrawnObjects, WorldMesh, draw_objects
from ..spec import ObjectSpec, bounds

RANGE = re.compile(r"#\s*(-?[\d.]+) to (-?[\d.]+)(?:\s+(m|deg|kg))?\s*$")
"""Comment after a parameter of a template, which states the parameter's range and unit."""


class NamedConstant(NamedTuple):
    """A positive float that a program assigns, exactly once, to a name at top level."""

    name: str
    value: float
    line: int
    """Line of the literal, counted from 0."""
    start: int
    """Column of the literal's first byte in UTF-8, counted from 0."""
    end: int
    """Column after the literal's last byte."""
    low: float = 0.0
    """Lower bound that the comment after a template's parameter states."""
    high: float = math.inf
    """Upper bound that the comment states."""

    def within(self, value: float) -> float:
        """Return the value, clipped to the range from `low` to `high`."""
        return min(max(value, self.low), self.high)


def named_constants(text: str) -> tuple[NamedConstant, ...]:
    """Return the named constants of a program, in the order of the text.

    Integers are omitted, because they are counts rather than lengths. Names that are assigned more
    than once, or in a loop or a function, are omitted, because they are not constant. If the text
    is not valid Python, return no constants.
    """
    if "\r" in text.replace("\r\n", "\n"):
        return ()  # Python ends a line at a bare "\r", so its line numbers would not fit `lines`.
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return ()
    stored = Counter(
        node.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    )
    lines = text.split("\n")
    constants = []
    for node in tree.body:
        for target, value in _pairs(node):
            if stored[target] != 1 or value.end_col_offset is None:
                continue
            number = value.value
            if not isinstance(number, float) or not 0 < number < math.inf:
                continue
            line = value.lineno - 1
            comment = lines[line].encode()[value.end_col_offset :].decode().strip()
            match = RANGE.match(comment)
            limits = (0.0, math.inf) if match is None else (float(match[1]), float(match[2]))
            span = value.col_offset, value.end_col_offset
            constants.append(NamedConstant(target, number, line, *span, *limits))
    return tuple(constants)


def _pairs(node: ast.stmt) -> list[tuple[str, ast.Constant]]:
    """Return pairs of a name and the literal that an assignment statement assigns to it."""
    if isinstance(node, ast.AnnAssign):
        targets: list[ast.expr] = [node.target]
        values = [node.value]
    elif isinstance(node, ast.Assign) and len(node.targets) == 1:
        targets, values = [node.targets[0]], [node.value]
        if isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple):
            targets, values = node.targets[0].elts, list(node.value.elts)
    else:
        return []
    if len(targets) != len(values):
        return []
    return [
        (target.id, value)
        for target, value in zip(targets, values, strict=True)
        if isinstance(target, ast.Name) and isinstance(value, ast.Constant)
    ]


def with_value(text: str, constant: NamedConstant, value: float) -> str:
    """Return the text with the literal of a constant replaced by another number.

    The number is rounded to four significant digits. The rest of the text is unchanged.

    Raises:
        ValueError: the line does not contain the constant's literal, or the number is not positive
            and finite.
    """
    if not 0 < value < math.inf:
        raise ValueError(f"{constant.name} must be positive and finite, got {value!r}")
    lines = text.split("\n")
    line = lines[constant.line].encode() if constant.line < len(lines) else b""
    literal = line[constant.start : constant.end].decode("utf-8", "replace")
    try:
        matches = float(literal) == constant.value
    except ValueError:
        matches = False
    if not matches:
        raise ValueError(f"line {constant.line + 1} does not hold {constant.name} any more")
    number = repr(float(f"{value:.4g}"))
    lines[constant.line] = (
        line[: constant.start] + number.encode() + line[constant.end :]
    ).decode()
    return "\n".join(lines)


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

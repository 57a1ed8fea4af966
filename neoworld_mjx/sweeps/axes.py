"""Axes of a plan: lists of values, ranges of evenly spaced values, and ranges to sample from."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field, ValidationError

from ..errors import ConfigError, choices
from ..io.validation_message import validation_message
from ..options import Options

MAX_POINTS = 10_000
"""Maximum number of points of a plan."""


class AxisRange(Options):
    """Range of an axis: `n` evenly spaced values, or values that are sampled at random."""

    low: float
    high: float
    log: bool = False
    """If True, values are spaced or sampled evenly on a logarithmic scale."""
    n: int | None = Field(default=None, ge=2, le=MAX_POINTS)
    """Number of values, including both ends. If None, values are sampled; see `Plan.samples`."""

    def at(self, share: float) -> float:
        """Return the value at a fraction of the range: `low` at 0, `high` at 1."""
        if share in (0.0, 1.0):
            return self.high if share else self.low
        if self.log:
            return math.exp(math.log(self.low) + share * math.log(self.high / self.low))
        return self.low + share * (self.high - self.low)


class Axes(NamedTuple):
    """Validated axes of a plan, by the paths of their options."""

    lists: dict[str, list[Any]]
    """Values of each list, and of each range with `n`."""
    ranges: dict[str, AxisRange]
    """Ranges without `n`, from which values are sampled."""


def read_axes(axes: Mapping[str, Any], takes_integers: Callable[[str], bool]) -> Axes:
    """Validate the axes of a plan.

    Args:
        axes: a list of values or the mapping of an `AxisRange`, by the path of an option.
        takes_integers: function that returns whether an option takes only integers. Values of a
            range are then rounded.

    Raises:
        ConfigError: an axis has no values, or is neither a list nor a range.
    """
    result = Axes({}, {})
    for path, value in axes.items():
        if isinstance(value, list | tuple):
            if not value:
                raise ConfigError(f"axes: {path} has no values")
            result.lists[path] = list(value)
            continue
        if not isinstance(value, Mapping):
            raise ConfigError(
                f"axes: {path}: give a list of values, or a range such as "
                f"{{low: 0.01, high: 0.1, log: true, n: 4}}, got {value!r}"
            )
        limits = _range(path, value)
        if limits.n is None:
            result.ranges[path] = limits
            continue
        values: list[Any] = [limits.at(k / (limits.n - 1)) for k in range(limits.n)]
        if takes_integers(path):
            values = list(dict.fromkeys(map(round, values)))
        result.lists[path] = values
    return result


def _range(path: str, value: Mapping[str, Any]) -> AxisRange:
    try:
        limits = AxisRange.model_validate(dict(value))
    except ValidationError as error:
        raise ConfigError(f"axes: {path}: {validation_message(error, AxisRange)}") from None
    if not limits.low < limits.high:
        raise ConfigError(f"axes: {path}: low must be below high, got {limits.low:g} and "
                          f"{limits.high:g}")  # fmt: skip
    if limits.log and limits.low <= 0:
        raise ConfigError(
            f"axes: {path}: low of a logarithmic range must be above 0, got {limits.low:g}"
        )
    return limits


def combinations(
    axes: Axes,
    zipped: Sequence[Sequence[str]],
    samples: int,
    draw_seed: int,
    takes_integers: Callable[[str], bool],
) -> list[dict[str, Any]]:
    """Return the values of every point, by the paths of the options.

    Args:
        axes: the axes.
        zipped: groups of axes whose values advance together instead of being combined.
        samples: number of samples from the ranges. Each sample is combined with every combination
            of the values in lists.
        draw_seed: random seed of the samples.
        takes_integers: see `read_axes`.

    Raises:
        ConfigError: a group names an axis that does not exist or axes of different lengths, there
            are ranges without samples or samples without ranges, or there are too many points.
    """
    groups = _groups(axes.lists, zipped)
    if axes.ranges and not samples:
        raise ConfigError(
            f"axes: {', '.join(axes.ranges)} is drawn at random: set the plan's samples, or set n "
            "for evenly spaced values"
        )
    if samples and not axes.ranges:
        raise ConfigError("samples: no axis is a range without n, from which values are drawn")
    count = math.prod(len(axes.lists[group[0]]) for group in groups) * max(samples, 1)
    if count > MAX_POINTS:
        raise ConfigError(
            f"axes: {count} points, at most {MAX_POINTS} are allowed; use fewer values, several "
            "plans, or draw the values of some axes at random"
        )
    steps = [
        [dict(zip(group, row, strict=True)) for row in _rows(axes.lists, group)] for group in groups
    ]
    if axes.ranges:
        steps.append(sample_values(axes.ranges, samples, draw_seed, takes_integers))
    merged = [
        {path: value for part in parts for path, value in part.items()}
        for parts in itertools.product(*steps)
    ]
    order = [*axes.lists, *axes.ranges]
    return [{path: point[path] for path in order} for point in merged]


def sample_values(
    ranges: Mapping[str, AxisRange], samples: int, seed: int, takes_integers: Callable[[str], bool]
) -> list[dict[str, Any]]:
    """Sample values uniformly from ranges.

    If `samples` is increased, the earlier samples stay the same.
    """
    rows = np.random.default_rng(seed).random((samples, len(ranges)))
    return [
        {
            path: round(limits.at(float(x))) if takes_integers(path) else limits.at(float(x))
            for (path, limits), x in zip(ranges.items(), row, strict=True)
        }
        for row in rows
    ]


def _groups(lists: Mapping[str, list[Any]], zipped: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return the groups of axes that advance together, in the order of the axes.

    An axis that is not zipped with others is a group of its own.
    """
    group_of: dict[str, list[str]] = {}
    for group in zipped:
        for path in group:
            if path not in lists:
                raise ConfigError(f"zip: {choices(path, lists)}")
            if path in group_of:
                raise ConfigError(f"zip: {path} appears twice")
            group_of[path] = list(group)
        lengths = {path: len(lists[path]) for path in group}
        if len(set(lengths.values())) > 1:
            lengths_text = ", ".join(f"{path} has {n}" for path, n in lengths.items())
            raise ConfigError(
                f"zip: axes that advance together must have equal numbers of values: {lengths_text}"
            )
    groups: list[list[str]] = []
    for path in lists:
        group = group_of.get(path, [path])
        if group not in groups:
            groups.append(group)
    return groups


def _rows(lists: Mapping[str, list[Any]], group: Sequence[str]) -> list[tuple[Any, ...]]:
    return list(zip(*(lists[path] for path in group), strict=True))

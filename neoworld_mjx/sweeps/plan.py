"""Plans of sweeps and ablations: YAML files that are completely validated before the first run."""

import difflib
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError

from ..config import (
    Config,
    Options,
    RefineOptions,
    load_config,
    merged,
    option_values,
    read_yaml,
)
from ..errors import ConfigError, choices
from ..io.text_files import validation_message

ROOT = "refine"
"""Group of the options that plans can vary."""
BASE = "base"
"""Label of the point of an ablation without changes."""
_DEFAULTS = option_values(RefineOptions(), f"{ROOT}.")
"""Defaults of the options of the search, by path."""
MAX_POINTS = MAX_SEEDS = 10_000
"""Maximum number of points, and of seeds, of a plan."""


def _seeds(value: Any) -> Any:
    """Return the seeds 0 to N - 1 for a number N, and a list of seeds unchanged."""
    if isinstance(value, int) and not isinstance(value, bool):
        if not 1 <= value <= MAX_SEEDS:
            raise ValueError(f"must be a number of seeds from 1 to {MAX_SEEDS}, or a list of seeds")
        return tuple(range(value))
    if not isinstance(value, list | tuple):
        raise ValueError("must be a number of seeds or a list of seeds")
    return value


class _Request(Options):
    scenes: tuple[str, ...] = ()
    """Paths of scene.json files or run folders, or names of scenes as KIND:NAME."""
    config: Path | None = None
    """YAML file of options that all points share."""
    base: dict[str, Any] = {}
    """Options that override the options in `config`."""
    seeds: Annotated[tuple[int, ...], BeforeValidator(_seeds)] = Field(
        default=(0, 1, 2, 3), min_length=1
    )
    """Seeds of the search, or a number N, which stands for the seeds 0 to N - 1."""


class Plan(_Request):
    """Plan of a sweep: every combination of the axes' values, with every seed, on every scene."""

    axes: dict[str, Any] = {}
    """Values by the path of an option, such as `refine.reward.w_drift`.

    The values are a list, or an `AxisRange` such as `{low: 0.01, high: 0.1, log: true, n: 4}`. If
    a range has no `n`, its values are sampled.
    """
    zip: tuple[tuple[str, ...], ...] = ()
    """Groups of axes whose values advance together instead of being combined."""
    samples: int = Field(default=0, ge=0, le=MAX_POINTS)
    """Number of samples from the ranges without `n`. Each is combined with all other values."""
    draw_seed: int = Field(default=0, ge=0)
    """Seed of these samples."""


class Ablation(_Request):
    """Plan of an ablation: base options and named variants, with every seed, on every scene."""

    variants: dict[str, dict[str, Any]] = {}
    """Values of each variant, by the path of an option."""


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


class Point(NamedTuple):
    """One setting of the options of the search."""

    label: str
    values: dict[str, Any]
    """Values that distinguish the point from others, by column."""
    options: RefineOptions
    """Complete options of the search."""


Request = TypeVar("Request", Plan, Ablation)


def read_plan(source: Request | Mapping[str, Any] | Path | str, kind: type[Request]) -> Request:
    """Read a plan from a YAML file or a mapping. Return an instance of `kind` unchanged.

    Raises:
        ConfigError: the file is missing or not a YAML mapping, or a key or value is invalid.
    """
    if isinstance(source, kind):
        return source
    where, data = "plan", source
    if isinstance(source, str | Path):
        where = str(source)
        data = read_yaml(Path(source), "plan")
    if not isinstance(data, Mapping):
        raise ConfigError(f"{where} must be a mapping with the keys {', '.join(kind.model_fields)}")
    try:
        plan = kind.model_validate(dict(data))
    except ValidationError as error:
        raise ConfigError(f"{where}: {validation_message(error, kind)}") from None
    if len(plan.seeds) > MAX_SEEDS:
        raise ConfigError(f"{where}: {len(plan.seeds)} seeds, at most {MAX_SEEDS} are allowed")
    if len(set(plan.seeds)) < len(plan.seeds) or min(plan.seeds) < 0:
        raise ConfigError(f"{where}: seeds must be different and not negative, got {plan.seeds}")
    return plan


def points(plan: Plan | Ablation) -> list[Point]:
    """Validate a plan and return its points.

    Raises:
        ConfigError: a path is not an option (the message suggests similar options), an axis has no
            values or an invalid value, there are too many points, or a point appears twice.
    """
    shared = load_config(plan.config, plan.base)
    # Points override the complete options of the base, including defaults.
    base = shared.model_dump(mode="json")
    if isinstance(plan, Plan):
        return _sweep_points(plan, base)
    variants = [Point(BASE, {"variant": BASE}, shared.refine)]
    for name, values in plan.variants.items():
        if name == BASE:
            raise ConfigError(f"variants: {BASE!r} is reserved for the options without changes")
        if not values:
            raise ConfigError(f"variants: {name!r} changes nothing")
        options = _with_values(base, values, f"variants: {name}")
        if options == shared.refine:
            raise ConfigError(f"variants: {name!r} equals the base")
        variants.append(Point(name, {"variant": name}, options))
    if len(variants) == 1:
        raise ConfigError("variants: name at least one, with the options that it changes")
    return variants


def _sweep_points(plan: Plan, base: dict[str, Any]) -> list[Point]:
    result: dict[str, Point] = {}
    for chosen in _combinations(plan):
        options = _with_values(base, chosen, "axes")
        # Validated values make 1 and 1.0 the same point.
        dump = {ROOT: options.model_dump(mode="json")}
        values = {path: _value_at(dump, path) for path in chosen}
        label = ", ".join(
            f"{path.removeprefix(ROOT + '.')} {_format_value(value)}"
            for path, value in values.items()
        )
        if label in result and plan.samples:
            continue  # The same integers were sampled before.
        if label in result:
            raise ConfigError(f"axes: the point {label} appears twice")
        result[label] = Point(label or BASE, values, options)
    return list(result.values())


def _combinations(plan: Plan) -> list[dict[str, Any]]:
    """Return the values of every point, by the paths of the options in the order of the axes."""
    lists: dict[str, list[Any]] = {}
    ranges: dict[str, AxisRange] = {}
    for path, value in plan.axes.items():
        integers = _is_integer(path, "axes")
        if isinstance(value, list | tuple):
            lists[path] = list(value)
        elif (limits := _range(path, value)).n is None:
            ranges[path] = limits
        else:
            spaced = [limits.at(k / (limits.n - 1)) for k in range(limits.n)]
            lists[path] = list(dict.fromkeys(map(round, spaced))) if integers else spaced
        if not lists.get(path, True):
            raise ConfigError(f"axes: {path} has no values")
    if ranges and not plan.samples:
        raise ConfigError(
            f"axes: {', '.join(ranges)} is drawn at random: set the plan's samples, or set n "
            "for evenly spaced values"
        )
    if plan.samples and not ranges:
        raise ConfigError("samples: no axis is a range without n, from which values are drawn")
    groups = _groups(lists, plan.zip)
    count = math.prod(len(lists[group[0]]) for group in groups) * max(plan.samples, 1)
    if count > MAX_POINTS:
        raise ConfigError(
            f"axes: {count} points, at most {MAX_POINTS} are allowed; use fewer values, several "
            "plans, or draw the values of some axes at random"
        )
    steps = [
        [{path: lists[path][k] for path in group} for k in range(len(lists[group[0]]))]
        for group in groups
    ]
    if ranges:
        steps.append(_sample(ranges, plan.samples, plan.draw_seed))
    combined = [
        {path: value for part in parts for path, value in part.items()}
        for parts in itertools.product(*steps)
    ]
    return [{path: point[path] for path in (*lists, *ranges)} for point in combined]


def _range(path: str, value: Any) -> AxisRange:
    if not isinstance(value, Mapping):
        raise ConfigError(
            f"axes: {path}: give a list of values, or a range such as "
            f"{{low: 0.01, high: 0.1, log: true, n: 4}}, got {value!r}"
        )
    try:
        limits = AxisRange.model_validate(dict(value))
    except ValidationError as error:
        raise ConfigError(f"axes: {path}: {validation_message(error, AxisRange)}") from None
    low, high = limits.low, limits.high
    if not low < high:
        raise ConfigError(f"axes: {path}: low must be below high, got {low:g} and {high:g}")
    if limits.log and low <= 0:
        raise ConfigError(f"axes: {path}: low of a logarithmic range must be above 0, got {low:g}")
    return limits


def _sample(ranges: Mapping[str, AxisRange], samples: int, seed: int) -> list[dict[str, Any]]:
    """Sample values uniformly from ranges; with more samples, the earlier ones stay the same."""
    integers = {path for path in ranges if _is_integer(path, "axes")}
    return [
        {
            path: round(limits.at(float(x))) if path in integers else limits.at(float(x))
            for (path, limits), x in zip(ranges.items(), row, strict=True)
        }
        for row in np.random.default_rng(seed).random((samples, len(ranges)))
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


def _with_values(base: dict[str, Any], values: Mapping[str, Any], where: str) -> RefineOptions:
    """Return the options of a search in which values, by dotted path, override the base."""
    overrides: dict[str, Any] = {}
    for path, value in values.items():
        _is_integer(path, where)
        tree = overrides
        *heads, last = path.split(".")
        for name in heads:
            tree = tree.setdefault(name, {})
        tree[last] = value
    complete = merged(base, overrides)
    terms = overrides.get(ROOT, {}).get("reward", {}).get("terms")
    if isinstance(terms, dict):  # The terms replace all terms of the base.
        complete[ROOT]["reward"]["terms"] = terms
    try:
        return Config.model_validate(complete).refine
    except ValidationError as error:
        raise ConfigError(f"{where}: {validation_message(error, Config)}") from None


def _is_integer(path: str, where: str) -> bool:
    """Return True if an option of the search is an integer.

    Raises:
        ConfigError: there is no such option; the message suggests similar ones.
    """
    if path not in _DEFAULTS:
        near = ", ".join(difflib.get_close_matches(path, _DEFAULTS, n=3, cutoff=0.0))
        raise ConfigError(f"{where}: {path} is no option of the search; the nearest are {near}")
    return type(_DEFAULTS[path]) is int


def _value_at(tree: Mapping[str, Any], path: str) -> Any:
    value: Any = tree
    for name in path.split("."):
        value = value[name]
    return value


def _format_value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(plain_value(value))


def plain_value(value: Any) -> Any:
    """Return a number, a string or a boolean unchanged, and any other value as JSON."""
    return value if isinstance(value, bool | int | float | str) else json.dumps(value)

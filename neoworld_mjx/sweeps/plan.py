"""Plans of sweeps and ablations: YAML files that are fully validated before the first run."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from ..config import Config, Options, RefineOptions, load_config, merged, read_yaml
from ..errors import ConfigError, choices
from ..io.validation_message import validation_message
from .axes import MAX_POINTS, combinations, read_axes

ROOT = "refine"
"""Group of options that plans may set."""
MAX_SEEDS = 10_000


def _seeds(value: Any) -> Any:
    """Return the seeds that a number stands for, and everything else unchanged."""
    if isinstance(value, int) and not isinstance(value, bool):
        if not 1 <= value <= MAX_SEEDS:
            raise ValueError(f"must be a number of seeds from 1 to {MAX_SEEDS}, or a list of seeds")
        return tuple(range(value))
    if not isinstance(value, list | tuple):
        raise ValueError("must be a number of seeds or a list of seeds")
    return value


class _Request(Options):
    scenes: tuple[str, ...] = ()
    """scene.json files, run folders, or named scenes as KIND:NAME."""
    config: Path | None = None
    """YAML file of options that all points share."""
    base: dict[str, Any] = {}
    """Options that override those of `config`."""
    seeds: Annotated[tuple[int, ...], BeforeValidator(_seeds)] = Field(
        default=(0, 1, 2, 3), min_length=1
    )
    """Seeds of the search; a number N stands for 0 to N - 1."""
    scores: Path | None = None
    """Folder of semantic scores recorded by an earlier run of the plan; replaces model calls."""
    tapes: tuple[Path, ...] = ()
    """Tapes of responses, or folders of tapes, for the provider `replay`."""


class Study(Options):
    """Adaptive choice of points by Optuna; see `study`."""

    trials: int = Field(ge=1, le=MAX_POINTS)
    """Number of points."""
    sampler: Literal["tpe", "cma_es", "random"] = "tpe"
    goal: str = "merit"
    """Column of the rows whose mean over scenes and seeds is the value of a point."""
    direction: Literal["maximize", "minimize"] = "maximize"
    prune: bool = False
    """True to end trials early, after some of the scenes (asynchronous successive halving)."""
    seed: int = Field(default=0, ge=0)


class Plan(_Request):
    """A sweep: every combination of the axes' values, with every seed, on every scene."""

    axes: dict[str, Any] = {}
    """Values by the path of an option, such as `refine.reward.w_drift`: a list, or an `AxisRange`
    such as `{low: 0.01, high: 0.1, log: true, n: 4}`; without `n` values are drawn."""
    zip: tuple[tuple[str, ...], ...] = ()
    """Groups of axes whose values advance together instead of being combined."""
    samples: int = Field(default=0, ge=0, le=MAX_POINTS)
    """Number of draws from the axes that are ranges without `n`."""
    draw_seed: int = Field(default=0, ge=0)
    """Seed of the draws."""
    study: Study | None = None
    """Lets Optuna choose the points; None combines the axes' values."""
    fold: bool = True
    """True if runs that differ only in traced options share a computation."""


class Ablation(_Request):
    """An ablation: base options and named variants, with every seed, on every scene."""

    variants: dict[str, dict[str, Any]] = {}
    """Values by the path of an option, for each variant."""
    fold: bool = False
    """The option of `Plan`; if False, every run is timed like a single refinement."""


class Point(NamedTuple):
    """One setting of the options."""

    label: str
    values: dict[str, Any]
    """Values that distinguish the point, by column."""
    options: RefineOptions


BASE = "base"
"""Label of an ablation's base."""

Request = TypeVar("Request", Plan, Ablation)


def read(source: Request | Mapping[str, Any] | Path | str, kind: type[Request]) -> Request:
    """Read a plan from a YAML file or a mapping; an instance of `kind` is returned unchanged.

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


def shared_config(plan: Plan | Ablation) -> Config:
    """Return the options that all points share, including those of models.

    Raises:
        ConfigError: an option is invalid.
    """
    return load_config(plan.config, plan.base)


def points(plan: Plan | Ablation) -> list[Point]:
    """Validate a plan and return its points.

    Raises:
        ConfigError: an axis is not an option, has no values or an invalid one, or a value repeats;
            the message suggests similar options.
    """
    shared = shared_config(plan)
    # Points override the complete options of the base, including defaults.
    base = shared.model_dump(mode="json")
    if isinstance(plan, Plan):
        return _points(plan, base)
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


def _points(plan: Plan, base: dict[str, Any]) -> list[Point]:
    for path in plan.axes:
        _annotation(path, "axes")
    axes = read_axes(plan.axes, takes_integers)
    ends = {path: [limits.low, limits.high] for path, limits in axes.ranges.items()}
    for path, values in (axes.lists | ends).items():
        for value in values:
            _with_values(base, {path: round(value) if path in ends and takes_integers(path)
                                else value}, "axes")  # fmt: skip
    found: dict[str, Point] = {}
    every = combinations(axes, plan.zip, plan.samples, plan.draw_seed, takes_integers)
    for chosen in every:
        point = point_of(base, chosen)
        if point.label in found and plan.samples:
            continue  # Integers are drawn twice.
        if point.label in found:
            raise ConfigError(f"axes: the point {point.label} appears twice")
        found[point.label] = point
    return list(found.values())


def point_of(base: dict[str, Any], chosen: Mapping[str, Any]) -> Point:
    """Return the point with some options' values, by path.

    Args:
        base: the complete options that it overrides.
        chosen: values by path.

    Raises:
        ConfigError: a value is invalid.
    """
    options = _with_values(base, chosen, "axes")
    # Validated values make 1 and 1.0 the same point.
    dump = {ROOT: options.model_dump(mode="json")}
    values = {path: _value_at(dump, path) for path in chosen}
    label = ", ".join(f"{path.removeprefix(ROOT + '.')} {_shown(values[path])}" for path in chosen)
    return Point(label or BASE, values, options)


def takes_integers(path: str) -> bool:
    """Return whether an option's values are integers."""
    return _annotation(path, "axes") is int


def _with_values(base: dict[str, Any], values: Mapping[str, Any], where: str) -> RefineOptions:
    overrides: dict[str, Any] = {}
    for path, value in values.items():
        _annotation(path, where)
        tree = overrides
        *heads, last = path.split(".")
        for name in heads:
            tree = tree.setdefault(name, {})
        tree[last] = value
    try:
        return Config.model_validate(_replaced(base, overrides)).refine
    except ValidationError as error:
        raise ConfigError(f"{where}: {validation_message(error, Config)}") from None


def _replaced(base: dict[str, Any], overrides: dict[str, Any]) -> dict[str, Any]:
    result = merged(base, overrides)
    terms = overrides.get(ROOT, {}).get("reward", {}).get("terms")
    if isinstance(terms, dict):  # Terms replace those of the base.
        result[ROOT]["reward"]["terms"] = terms
    return result


def _annotation(path: str, where: str) -> Any:
    """Return the type of an option; a ConfigError suggests similar ones."""
    head, *names = path.split(".")
    if head != ROOT:
        raise ConfigError(
            f"{where}: {path} is not an option of the search; paths begin with {ROOT}."
        )
    group: Any = RefineOptions
    for name in names:
        if not (isinstance(group, type) and issubclass(group, BaseModel)):
            raise ConfigError(f"{where}: {path}: {head} is not a group")
        if name not in group.model_fields:
            raise ConfigError(f"{where}: no option {path}: {choices(name, group.model_fields)}")
        head = f"{head}.{name}"
        group = group.model_fields[name].annotation
    if isinstance(group, type) and issubclass(group, BaseModel):
        members = ", ".join(f"{path}.{name}" for name in group.model_fields)
        raise ConfigError(f"{where}: {path} is a group of options: name one of {members}")
    return group


def _value_at(tree: dict[str, Any], path: str) -> Any:
    value: Any = tree
    for name in path.split("."):
        value = value[name]
    return value


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(plain(value))


def plain(value: Any) -> Any:
    """Return a value that a column can hold: a number, a string or a boolean."""
    return value if isinstance(value, bool | int | float | str) else json.dumps(value)

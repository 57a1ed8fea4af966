"""Plans of sweeps and ablations: YAML files that are completely validated before the first run."""

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
"""Group of the options that plans can vary."""
MAX_SEEDS = 10_000
"""Maximum number of seeds of a plan."""


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
    scores: Path | None = None
    """Folder of semantic scores that an earlier run of the plan recorded. If given, no model is
    asked."""
    tapes: tuple[Path, ...] = ()
    """Tapes of recorded responses, or folders of tapes, for the provider `replay`."""


class Study(Options):
    """Options of a study, in which Optuna chooses the points adaptively; see `study`."""

    trials: int = Field(ge=1, le=MAX_POINTS)
    """Number of points."""
    sampler: Literal["tpe", "cma_es", "random"] = "tpe"
    goal: str = "merit"
    """Column of the rows. Its mean over scenes and seeds is the value of a point."""
    direction: Literal["maximize", "minimize"] = "maximize"
    prune: bool = False
    """If True, poor trials end after some of the scenes (asynchronous successive halving)."""
    seed: int = Field(default=0, ge=0)
    """Seed of the sampler."""


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
    """Number of samples from the ranges without `n`."""
    draw_seed: int = Field(default=0, ge=0)
    """Seed of these samples."""
    study: Study | None = None
    """Study in which Optuna chooses the points. If None, the values of the axes are combined."""
    fold: bool = True
    """If True, runs that differ only in traced options share a computation."""


class Ablation(_Request):
    """Plan of an ablation: base options and named variants, with every seed, on every scene."""

    variants: dict[str, dict[str, Any]] = {}
    """Values of each variant, by the path of an option."""
    fold: bool = False
    """See `Plan.fold`. If False, the time of every run is that of a single refinement."""


class Point(NamedTuple):
    """One setting of the options of the search."""

    label: str
    values: dict[str, Any]
    """Values that distinguish the point from others, by column."""
    options: RefineOptions
    """Complete options of the search."""


BASE = "base"
"""Label of the point of an ablation without changes."""

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


def shared_config(plan: Plan | Ablation) -> Config:
    """Return the options that all points share, including the options of models.

    Raises:
        ConfigError: an option is invalid.
    """
    return load_config(plan.config, plan.base)


def points(plan: Plan | Ablation) -> list[Point]:
    """Validate a plan and return its points.

    Raises:
        ConfigError: a path is not an option (the message suggests similar options), an axis has no
            values or an invalid value, or a point appears twice.
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
    points_by_label: dict[str, Point] = {}
    every = combinations(axes, plan.zip, plan.samples, plan.draw_seed, takes_integers)
    for chosen in every:
        point = point_of(base, chosen)
        if point.label in points_by_label and plan.samples:
            continue  # The same integers were sampled before.
        if point.label in points_by_label:
            raise ConfigError(f"axes: the point {point.label} appears twice")
        points_by_label[point.label] = point
    return list(points_by_label.values())


def point_of(base: dict[str, Any], chosen: Mapping[str, Any]) -> Point:
    """Return the point with the given values of options.

    Args:
        base: complete options, which the values override.
        chosen: values by the path of the option.

    Raises:
        ConfigError: a value is invalid.
    """
    options = _with_values(base, chosen, "axes")
    # Validated values make 1 and 1.0 the same point.
    dump = {ROOT: options.model_dump(mode="json")}
    values = {path: value_at(dump, path) for path in chosen}
    label = ", ".join(
        f"{path.removeprefix(ROOT + '.')} {_format_value(values[path])}" for path in chosen
    )
    return Point(label or BASE, values, options)


def takes_integers(path: str) -> bool:
    """Return whether the values of an option are integers."""
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
        return Config.model_validate(_override(base, overrides)).refine
    except ValidationError as error:
        raise ConfigError(f"{where}: {validation_message(error, Config)}") from None


def _override(base: dict[str, Any], overrides: dict[str, Any]) -> dict[str, Any]:
    result = merged(base, overrides)
    terms = overrides.get(ROOT, {}).get("reward", {}).get("terms")
    if isinstance(terms, dict):  # The terms replace all terms of the base.
        result[ROOT]["reward"]["terms"] = terms
    return result


def _annotation(path: str, where: str) -> Any:
    """Return the type of an option; raise a ConfigError that suggests similar options."""
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


def value_at(tree: Mapping[str, Any], path: str) -> Any:
    """Return the value at a dotted path in nested mappings."""
    value: Any = tree
    for name in path.split("."):
        value = value[name]
    return value


def _format_value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(plain_value(value))


def plain_value(value: Any) -> Any:
    """Return a number, a string or a boolean unchanged, and any other value as JSON."""
    return value if isinstance(value, bool | int | float | str) else json.dumps(value)

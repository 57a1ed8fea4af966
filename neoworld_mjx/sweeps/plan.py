"""Plans of sweeps and ablations: YAML files, validated in full before anything runs."""

import itertools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import yaml
from pydantic import BaseModel, Field, ValidationError

from ..config import Config, Options, RefineOptions, describe, load_config, merged
from ..errors import ConfigError, choices

ROOT = "refine"
"""Axes are options of this group."""


class _Request(Options):
    scenes: tuple[str, ...] = ()
    """scene.json files, run folders, or generated scenes as KIND:NAME."""
    config: Path | None = None
    """YAML of options that all points share."""
    base: dict[str, Any] = {}
    """Options that override those of `config`."""
    seeds: tuple[int, ...] = Field(default=(0, 1, 2, 3), min_length=1)


class Plan(_Request):
    """A sweep: every combination of the axes' values, with every seed, on every scene."""

    axes: dict[str, list[Any]] = {}
    """Values by the path of an option, such as `refine.reward.w_drift`."""
    fold: bool = True
    """Runs that differ in traced options alone are one computation."""


class Ablation(_Request):
    """A base and named changes of it, with every seed, on every scene."""

    variants: dict[str, dict[str, Any]] = {}
    """By name: values by the paths of options."""
    fold: bool = False
    """As in `Plan`. Separate runs are timed and pruned as a single refinement is."""


class Point(NamedTuple):
    """One setting of the options."""

    label: str
    values: dict[str, Any]
    """The values that distinguish it, by column."""
    options: RefineOptions


BASE = "base"
"""Label of an ablation's base."""

Request = TypeVar("Request", Plan, Ablation)


def read(source: Request | Mapping[str, Any] | Path | str, kind: type[Request]) -> Request:
    """Read a plan from a YAML file or a mapping; an instance of `kind` is returned as it is.

    Raises:
        ConfigError: the file is missing or no YAML mapping, or a key or value is wrong.
    """
    if isinstance(source, kind):
        return source
    where, data = "plan", source
    if isinstance(source, str | Path):
        where = str(source)
        try:
            data = yaml.safe_load(Path(source).read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"cannot read {source}: {error.strerror}") from None
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ConfigError(f"{source} is not valid YAML: {error}") from None
    if not isinstance(data, Mapping):
        raise ConfigError(f"{where} must be a mapping with the keys {', '.join(kind.model_fields)}")
    try:
        plan = kind.model_validate(dict(data))
    except ValidationError as error:
        raise ConfigError(f"{where}: {describe(error, kind)}") from None
    if len(set(plan.seeds)) < len(plan.seeds) or min(plan.seeds) < 0:
        raise ConfigError(f"{where}: seeds must be different and not negative, got {plan.seeds}")
    return plan


def points(plan: Plan | Ablation) -> list[Point]:
    """Validate and list the points of a plan.

    Raises:
        ConfigError: an axis names no option, has no values or one of a wrong type, or a value comes
            twice; the message names the option's neighbours.
    """
    shared = load_config(plan.config, plan.base)
    if shared.refine.semantic.scorer != "geometric":
        raise ConfigError("refine.semantic.scorer: sweeps score by geometry; choose geometric")
    # Points override the complete options of the base, defaults included.
    base = shared.model_dump(mode="json")
    if isinstance(plan, Plan):
        return _grid(plan.axes, base)
    variants = [Point(BASE, {"variant": BASE}, shared.refine)]
    for name, values in plan.variants.items():
        if name == BASE:
            raise ConfigError(f"variants: {BASE!r} is the name of the options without changes")
        if not values:
            raise ConfigError(f"variants: {name!r} changes nothing")
        options = _changed(base, values, f"variants: {name}")
        if options == shared.refine:
            raise ConfigError(f"variants: {name!r} sets options to what the base has already")
        variants.append(Point(name, {"variant": name}, options))
    if len(variants) == 1:
        raise ConfigError("variants: name at least one, with the options that it changes")
    return variants


def _grid(axes: dict[str, list[Any]], base: dict[str, Any]) -> list[Point]:
    for path, values in axes.items():
        if not values:
            raise ConfigError(f"axes: {path} has no values")
        for value in values:
            _changed(base, {path: value}, "axes")
    grid: dict[str, Point] = {}
    for combination in itertools.product(*axes.values()):
        options = _changed(base, dict(zip(axes, combination, strict=True)), "axes")
        # The values as the options have them: 1 and 1.0 are one point.
        dump = {ROOT: options.model_dump(mode="json")}
        values = {path: _at(dump, path) for path in axes}
        label = ", ".join(
            f"{path.removeprefix(ROOT + '.')} {_shown(values[path])}" for path in axes
        )
        if label in grid:
            raise ConfigError(f"axes: the point {label} comes twice")
        grid[label] = Point(label or BASE, values, options)
    return list(grid.values())


def _changed(base: dict[str, Any], values: Mapping[str, Any], where: str) -> RefineOptions:
    over: dict[str, Any] = {}
    for path, value in values.items():
        _check_path(path, where)
        tree = over
        *heads, last = path.split(".")
        for name in heads:
            tree = tree.setdefault(name, {})
        tree[last] = value
    try:
        options = Config.model_validate(_replaced(base, over)).refine
    except ValidationError as error:
        raise ConfigError(f"{where}: {describe(error, Config)}") from None
    if options.semantic.scorer != "geometric":
        raise ConfigError(f"{where}: sweeps score by geometry; leave refine.semantic.scorer out")
    return options


def _replaced(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    result = merged(base, over)
    terms = over.get(ROOT, {}).get("reward", {}).get("terms")
    if isinstance(terms, dict):  # A value as a whole, not laid over the base's.
        result[ROOT]["reward"]["terms"] = terms
    return result


def _check_path(path: str, where: str) -> None:
    head, *rest = path.split(".")
    if head != ROOT:
        raise ConfigError(f"{where}: {path} is no option of the search; paths begin with {ROOT}.")
    group: Any = RefineOptions
    for name in rest:
        if not (isinstance(group, type) and issubclass(group, BaseModel)):
            raise ConfigError(f"{where}: {path}: nothing lies under {head}")
        if name not in group.model_fields:
            raise ConfigError(f"{where}: no option {path}: {choices(name, group.model_fields)}")
        head = f"{head}.{name}"
        group = group.model_fields[name].annotation
    if isinstance(group, type) and issubclass(group, BaseModel):
        names = ", ".join(f"{path}.{name}" for name in group.model_fields)
        raise ConfigError(f"{where}: {path} is a group of options: name one of {names}")


def _at(tree: dict[str, Any], path: str) -> Any:
    value: Any = tree
    for name in path.split("."):
        value = value[name]
    return value


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(plain(value))


def plain(value: Any) -> Any:
    """Return a value as a column holds it: a number, a text or a truth value."""
    return value if isinstance(value, bool | int | float | str) else json.dumps(value)

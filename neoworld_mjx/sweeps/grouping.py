"""Grouping of points into computations: points with equal static options share a program."""

import json
from collections.abc import Sequence
from typing import NamedTuple

from ..config import RefineOptions, list_options, option_values
from ..refinement.batching import early_stop_rule

_OPTIONS = tuple(list_options(RefineOptions))
TRACED = tuple(option.path for option in _OPTIONS if option.kind == "traced")
"""Paths under `refine` of the options that are arrays; changing them needs no compilation."""
STATIC = {option.path: option.reason for option in _OPTIONS if option.kind == "static"}
"""Reasons of the options whose change needs another computation, by path."""
_STATIC_IF_EARLY_STOP = {o.path: o.reason for o in _OPTIONS if o.kind == "traced" and o.reason}
"""Traced options that set the rule of `rollout.early_stop`."""


class PointGroup(NamedTuple):
    """Points that share one computation."""

    members: tuple[int, ...]
    """Indices of the points."""
    compile_options: RefineOptions
    """Options to compile a scene with: those of the first member, with the largest sigma_xy."""


def static_part(options: RefineOptions) -> str:
    """Return the values that runs must have in common to share a computation, as JSON."""
    values = option_values(options)
    static = {path: values[path] for path in STATIC}
    static["terms"] = list(values["reward.terms"])
    if options.rollout.early_stop:
        rule = early_stop_rule(options)
        static["rule"] = [rule.distance, rule.angle, rule.drift, rule.tilt]
    return json.dumps(static, sort_keys=True)


def grouped(points: Sequence[RefineOptions], *, fold: bool = True) -> list[PointGroup]:
    """Group points by static options; without `fold` each point is its own group.

    All groups have the largest sigma_xy of the sweep, so that one compiled scene serves all points
    with the same time step and samples.
    """
    groups: dict[str, list[int]] = {}
    for k, options in enumerate(points):
        groups.setdefault(static_part(options) if fold else str(k), []).append(k)
    sigma = max(options.cem.sigma_xy for options in points)
    result = []
    for members in groups.values():
        first = points[members[0]]
        cem = first.cem.model_copy(update={"sigma_xy": sigma})
        result.append(PointGroup(tuple(members), first.model_copy(update={"cem": cem})))
    return result


def reasons(points: Sequence[RefineOptions], *, fold: bool = True) -> list[str]:
    """Return one line per static option that splits the points into groups."""
    tables = [option_values(options) for options in points]
    count = len({static_part(options) for options in points})
    if count == 1 or not fold:
        return []
    lines = []
    early_stop = any(options.rollout.early_stop for options in points)
    for name, reason in (STATIC | (_STATIC_IF_EARLY_STOP if early_stop else {})).items():
        values = list(dict.fromkeys(json.dumps(table[name]) for table in tables))
        if len(values) > 1:
            listed = ", ".join(value.strip('"') for value in values)
            lines.append(f"refine.{name} = {listed} ({reason}): compiles {len(values)} times")
    if len({tuple(table["reward.terms"]) for table in tables}) > 1:
        lines.append("refine.reward.terms: other terms are another program")
    return [*lines, f"so {len(points)} points are {count} computations per scene"]

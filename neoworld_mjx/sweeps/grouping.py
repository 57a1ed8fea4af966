"""Group points into computations: those whose options differ in no static one are one program.

The options themselves declare whether they are traced, static or of the host.
"""

import json
from collections.abc import Sequence
from typing import NamedTuple

from ..config import RefineOptions, list_options, option_values
from ..refinement.batching import early_stop_rule

_OPTIONS = tuple(list_options(RefineOptions))
TRACED = tuple(each.path for each in _OPTIONS if each.kind == "traced")
"""Paths under `refine` of the options that are arrays: other values need no compilation."""
STATIC = {each.path: each.reason for each in _OPTIONS if each.kind == "static"}
"""Options whose other values are another computation: the reason, by path."""
_SHARED = {each.path: each.reason for each in _OPTIONS if each.kind == "traced" and each.reason}
"""Traced options that also set where `rollout.early_stop` ends rollouts."""


class PointGroup(NamedTuple):
    """Points that are one computation."""

    members: tuple[int, ...]
    """Indices of the points."""
    reach: RefineOptions
    """Options that a scene is compiled with: those of the member of widest sigma_xy."""


def static_part(options: RefineOptions) -> str:
    """Return as text the values that must be equal for runs to be one computation."""
    values = option_values(options)
    static = {path: values[path] for path in STATIC}
    static["terms"] = list(values["reward.terms"])
    if options.rollout.early_stop:
        rule = early_stop_rule(options)
        static["rule"] = [rule.distance, rule.angle, rule.drift, rule.tilt]
    return json.dumps(static, sort_keys=True)


def grouped(every: Sequence[RefineOptions], *, fold: bool = True) -> list[PointGroup]:
    """Split points into groups; without `fold` each is a group of its own.

    All groups share the widest reach of snapping, so that one compiled scene serves them all.
    """
    groups: dict[str, list[int]] = {}
    for k, options in enumerate(every):
        groups.setdefault(static_part(options) if fold else str(k), []).append(k)
    return [PointGroup(tuple(members), _widest(every, members)) for members in groups.values()]


def _widest(every: Sequence[RefineOptions], members: Sequence[int]) -> RefineOptions:
    sigma = max(options.cem.sigma_xy for options in every)
    first = every[members[0]]
    return first.model_copy(update={"cem": first.cem.model_copy(update={"sigma_xy": sigma})})


def reasons(every: Sequence[RefineOptions], *, fold: bool = True) -> list[str]:
    """List the static options that split the points into groups, one line each."""
    tables = [option_values(options) for options in every]
    count = len({static_part(options) for options in every})
    if count == 1 or not fold:
        return []
    lines = []
    stops = any(options.rollout.early_stop for options in every)
    split = STATIC | _SHARED if stops else STATIC
    for name, reason in split.items():
        values = list(dict.fromkeys(json.dumps(table[name]) for table in tables))
        if len(values) > 1:
            listed = ", ".join(value.strip('"') for value in values)
            lines.append(f"refine.{name} = {listed} ({reason}): compiles {len(values)} times")
    if len({tuple(table["reward.terms"]) for table in tables}) > 1:
        lines.append("refine.reward.terms: other terms are another program")
    return [*lines, f"so {len(every)} points are {count} computations of a scene"]

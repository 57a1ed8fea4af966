"""Grouping of points into computations: points with equal static options are computed together."""

import json
from collections.abc import Sequence
from typing import NamedTuple

from ..config import RefineOptions, list_options, option_values
from ..refinement.batching import early_stop_rule
from ..refinement.compiling import reach_of

_OPTIONS = tuple(list_options(RefineOptions))
TRACED = tuple(option.path for option in _OPTIONS if option.kind == "traced")
"""Paths under `refine` of the traced options, whose change does not recompile."""
STATIC = {option.path: option.reason for option in _OPTIONS if option.kind == "static"}
"""Reasons why options are static, by path under `refine`. Their change recompiles."""
_STATIC_IF_EARLY_STOP = {o.path: o.reason for o in _OPTIONS if o.kind == "traced" and o.reason}
"""Reasons of traced options that are static if `rollout.early_stop` is true, because they set the
rule by which rollouts stop early."""


class PointGroup(NamedTuple):
    """Points that share one computation."""

    members: tuple[int, ...]
    """Indices of the points."""
    compile_options: RefineOptions
    """Options with which scenes are compiled: the options of the first member."""


def fixing_key(options: RefineOptions) -> str:
    """Return the values that determine which objects a search fixes, as JSON.

    All runs of one search fix the same objects. Runs whose values differ here are therefore
    searched separately; otherwise the result of a run would depend on the other runs.
    """
    o = options
    bounds = (o.max_depth_m, o.max_drift_m, o.max_tilt_deg, o.check_duration_s, o.check_timestep_s)
    return json.dumps(bounds if o.cem.hold_resting else None)


def static_key(options: RefineOptions) -> str:
    """Return the values that must be equal for runs to share a computation, as JSON."""
    values = option_values(options)
    static = {path: values[path] for path in STATIC}
    static["terms"] = list(values["reward.terms"])
    static["reach"] = reach_of(options)
    if options.rollout.early_stop:
        rule = early_stop_rule(options)
        static["rule"] = [rule.distance, rule.angle, rule.drift, rule.tilt]
    return json.dumps(static, sort_keys=True)


def group_points(points: Sequence[RefineOptions], *, together: bool = True) -> list[PointGroup]:
    """Group points whose static options are equal. If `together` is False, do not group points."""
    groups: dict[str, list[int]] = {}
    for k, options in enumerate(points):
        groups.setdefault(static_key(options) if together else str(k), []).append(k)
    return [PointGroup(tuple(members), points[members[0]]) for members in groups.values()]


def grouping_reasons(points: Sequence[RefineOptions], *, together: bool = True) -> list[str]:
    """Return a line for each static option that splits the points into groups, and their number.

    If there is only one group, or if `together` is False, there are no lines.
    """
    tables = [option_values(options) for options in points]
    count = len({static_key(options) for options in points})
    if count == 1 or not together:
        return []
    lines = []
    early_stop = any(options.rollout.early_stop for options in points)
    for name, reason in (STATIC | (_STATIC_IF_EARLY_STOP if early_stop else {})).items():
        values = list(dict.fromkeys(json.dumps(table[name]) for table in tables))
        if len(values) > 1:
            listed = ", ".join(value.strip('"') for value in values)
            lines.append(f"refine.{name} = {listed} ({reason}): compiles {len(values)} times")
    if len({tuple(table["reward.terms"]) for table in tables}) > 1:
        lines.append("refine.reward.terms: a change of the terms recompiles")
    if len({reach_of(options) for options in points}) > 1:
        lines.append("refine.cem.sigma_xy: larger values need a wider surface under each object")
    return [*lines, f"so {len(points)} points need {count} computations per scene"]

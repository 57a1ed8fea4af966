"""Which runs can be one computation: those whose options differ in traced ones alone."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

from ..config import RefineOptions
from ..refinement.cem import TRACED as CEM_TRACED
from ..refinement.loop import early_stop_rule
from ..refinement.rewards import TRACED as REWARD_TRACED

TRACED = tuple(dict.fromkeys(CEM_TRACED + REWARD_TRACED))
"""Options that are arrays: other values compile nothing anew."""

HOST = (
    "cem.iterations",
    "cem.patience",
    "max_drift_m",
    "max_tilt_deg",
    "check_duration_s",
    "check_timestep_s",
    "finalists",
    "cem.prune",
    "cem.batch",
)
"""Options that act on each run by itself, outside of what is compiled. Folded runs are not pruned,
which changes no elite."""

STATIC = {
    "cem.population": "shapes arrays",
    "cem.elite_ratio": "shapes arrays",
    "cem.first": "shapes arrays",
    "cem.zero_candidate": "is another program",
    "cem.credit": "is another program",
    "descent.warm_steps": "is another program",
    "descent.project": "is another program",
    "descent.project_steps": "is another program",
    "descent.rate": "is another program",
    "descent.samples": "shapes arrays",
    "reward.normalisation": "is another program",
    "rollout.engine": "is another program",
    "rollout.duration_s": "all candidates of a rollout share it",
    "rollout.timestep_s": "belongs to the compiled scene",
    "rollout.record_every_s": "shapes arrays",
    "rollout.early_stop": "is another program",
    "rollout.samples_per_object": "shapes arrays",
}
"""Options whose other values are another computation, and why."""

UNUSED = "semantic."
"""Sweeps score by geometry, so what asks a model acts on nothing."""

RULE = ("reward.d_drift_cap", "reward.drift_scale_m", "reward.tilt_scale_deg")
"""Traced, but they also set where `rollout.early_stop` ends rollouts, which all candidates share."""


class Group(NamedTuple):
    """Points that are one computation."""

    members: tuple[int, ...]
    """Indices of the points."""
    reach: RefineOptions
    """Options that a scene is compiled with: those of the member of widest sigma_xy."""


def leaves(options: RefineOptions) -> dict[str, Any]:
    """List options by their paths under `refine`; `reward.terms` is one of them."""
    found: dict[str, Any] = {}

    def walk(tree: dict[str, Any], at: str) -> None:
        for name, value in tree.items():
            if isinstance(value, dict) and name != "terms":
                walk(value, f"{at}{name}.")
            else:
                found[at + name] = value

    walk(options.model_dump(mode="json"), "")
    return found


def static_part(options: RefineOptions) -> str:
    """Return what must be equal for runs to be one computation, as a text."""
    every = leaves(options)
    kept: dict[str, Any] = {name: every[name] for name in STATIC}
    kept["terms"] = list(every["reward.terms"])
    if options.rollout.early_stop:
        rule = early_stop_rule(options)
        kept["rule"] = [rule.drift, rule.tilt]
    return json.dumps(kept, sort_keys=True)


def grouped(every: Sequence[RefineOptions], *, fold: bool = True) -> list[Group]:
    """Split points into groups; without `fold` each is one by itself.

    All groups share the widest reach of snapping, so that one compiled scene serves them all.
    """
    found: dict[str, list[int]] = {}
    for k, options in enumerate(every):
        found.setdefault(static_part(options) if fold else str(k), []).append(k)
    return [Group(tuple(members), _widest(every, members)) for members in found.values()]


def _widest(every: Sequence[RefineOptions], members: Sequence[int]) -> RefineOptions:
    sigma = max(options.cem.sigma_xy for options in every)
    first = every[members[0]]
    return first.model_copy(update={"cem": first.cem.model_copy(update={"sigma_xy": sigma})})


def reasons(every: Sequence[RefineOptions], *, fold: bool = True) -> list[str]:
    """Say which static options split the points into groups, one line each."""
    tables = [leaves(options) for options in every]
    count = len({static_part(options) for options in every})
    if count == 1 or not fold:
        return []
    lines = []
    stops = any(options.rollout.early_stop for options in every)
    split = STATIC | dict.fromkeys(RULE, "ends rollouts early") if stops else dict(STATIC)
    for name, why in split.items():
        values = list(dict.fromkeys(json.dumps(table[name]) for table in tables))
        if len(values) > 1:
            shown = ", ".join(value.strip('"') for value in values)
            lines.append(f"refine.{name} = {shown} ({why}): compiles {len(values)} times")
    if len({tuple(table["reward.terms"]) for table in tables}) > 1:
        lines.append("refine.reward.terms: other terms are another program")
    return [*lines, f"so {len(every)} points are {count} computations of a scene"]

"""Results of the object tests: checks with values, the faults that they report, and the verdict."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal

import numpy as np
from pydantic import AliasChoices, ConfigDict, Field

from ..quantities import format_quantity
from ..spec import Spec

Outcome = Literal["PASS", "FAIL", "SKIP", "TOOL_FAILURE"]
ScenarioKind = Literal[
    "static",
    "joint_range",
    "intent",
    "free_fall",
    "force_perturbation",
    "joint_release",
    "joint_drive",
]


class Fault(StrEnum):
    """Faults that the object tests report, ordered from likely causes to symptoms."""

    hint: str
    """Hint that says how to remedy the fault."""

    def __new__(cls, value: str, hint: str) -> "Fault":
        """Create a fault from its name and hint."""
        fault = str.__new__(cls, value)
        fault._value_, fault.hint = value, hint
        return fault

    COLLIDER_LARGE = "collider_large", "shrink the colliders to the visible shape"
    COLLIDER_MISSING = "collider_missing", "add colliders that cover the visible shape"
    INERTIA_IMPOSSIBLE = "inertia_impossible", "recompute the inertia from volume and density"
    MASS_IMPLAUSIBLE = (
        "mass_implausible",
        "derive the mass from volume and density, or make the part hollow",
    )
    JOINT_TYPE = "joint_type", "give the joint its declared type"
    AXIS_REVERSED = "axis_reversed", "reverse the axis: positive values open the joint"
    PART_DETACHED = "part_detached", "move the part until it touches the parent of its joint"
    PARTS_OVERLAP = "parts_overlap", "move the parts apart, or shrink their colliders"
    PIVOT_OFF = "pivot_off", "move the pivot to the edge that the two parts share"
    JOINT_INTO_PART = (
        "joint_into_part",
        "check the axis and its sign: the joint collides right away",
    )
    LIMIT_INTO_PART = "limit_into_part", "reduce the limits to the collision-free range"
    RANGE_CONFLICT = "range_conflict", "leave clearance for several joints that are open at once"
    LIMITS_NARROW = "limits_narrow", "widen the limits to the real object's range"
    OFF_BALANCE = "off_balance", "move the center of mass over the base, or widen the base"
    FRICTION_IMPLAUSIBLE = (
        "friction_implausible",
        "give the surface the friction of its material, 0.1 to 1.2",
    )
    JOINT_UNDAMPED = "joint_undamped", "give the joint damping or dry friction"
    JOINT_STUCK = "joint_stuck", "reduce friction, damping or stiffness, or clear the joint's path"
    JOINT_MOVES_ITSELF = (
        "joint_moves_itself",
        "leave clearance around the colliders that push the joint",
    )
    LIMIT_SOFT = "limit_soft", "reduce mass or speed, or widen the limits"
    DIVERGES = "diverges", "check masses, inertias and overlapping colliders"
    GAINS_ENERGY = (
        "gains_energy",
        "look for overlapping colliders or joints that work against each other",
    )
    SINKS_IN = "sinks_in", "check mass and colliders"
    TOPPLES = "topples", "lower the center of mass or widen the base"
    DRIFTS = "drifts", "widen or flatten the base"
    RESTLESS = "restless", "add damping; look for colliders that push against each other"


BORDERLINE = 0.8
"""Fraction of the distance from the best value to the threshold, above which a value is borderline.

A different time step or processor, or a small additional load, changes values by about 20 %.
"""


class Check(Spec):
    """Result of one check, with the value that decides it."""

    model_config = ConfigDict(serialize_by_alias=True)

    scenario: ScenarioKind
    name: str
    outcome: Outcome
    borderline: bool = Field(
        default=False,
        validation_alias=AliasChoices("borderline", "doubtful"),
        serialization_alias="doubtful",
    )
    """True if the check passes with a value close to the threshold."""
    fault: Fault | None = None
    """The fault that a failed check reports."""
    value: float | None = None
    threshold: float | None = None
    unit: str = ""
    part: str | None = None
    joint: str | None = None
    time: float | None = None
    """Time of the worst value [s]."""
    at: float | None = None
    """Position of the joint at the worst value [rad or m]."""
    evidence: str = ""
    """Description of the run or pose in which the value was measured."""
    hint: str = ""

    @property
    def failed(self) -> bool:
        """True if the check failed or could not be evaluated."""
        return self.outcome in ("FAIL", "TOOL_FAILURE")

    @property
    def least(self) -> bool:
        """True if the threshold is the smallest valid value; False if it is the largest."""
        if self.value is None or self.threshold is None:
            return False
        return (self.value > self.threshold) == (self.outcome == "PASS")

    def phrase(self) -> str:
        """Return the name, the value and the threshold, as in "drift 12.0 mm, at most 10.0 mm"."""
        name = self.name.replace("_", " ")
        if self.threshold is None:
            return name
        value = "not finite" if self.value is None else format_quantity(self.value, self.unit)
        bound = format_quantity(self.threshold, self.unit)
        return f"{name} {value}, {'at least' if self.least else 'at most'} {bound}"

    @property
    def margin(self) -> float:
        """Relative excess of a failed check's value over the threshold, clipped to 9.

        The margin is 0 if the check did not fail, and 9 if it could not be evaluated.
        """
        if self.outcome == "TOOL_FAILURE":
            return 9.0
        if self.outcome != "FAIL":
            return 0.0
        if self.value is None or not self.threshold:
            return 1.0
        return float(min(abs(self.value - self.threshold) / abs(self.threshold), 9.0))


class Verdict(Spec):
    """Results of all checks of one object."""

    object: str
    passed: bool
    """True if no check failed and every check could be evaluated; skipped checks do not count."""
    mass_kg: float
    battery: str = ""
    """Version of the object tests."""
    checks: tuple[Check, ...]

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Faults that the checks report, likely causes first."""
        reported = {check.fault for check in self.checks}
        return tuple(fault for fault in Fault if fault in reported)

    @property
    def borderline(self) -> tuple[Check, ...]:
        """Checks that pass with values close to their thresholds."""
        return tuple(check for check in self.checks if check.borderline)

    @property
    def questionable(self) -> bool:
        """True if a check failed or is borderline."""
        return not self.passed or bool(self.borderline)

    @property
    def cause(self) -> Fault | None:
        """The fault that likely explains the other faults, or None without faults."""
        return next(iter(self.faults), None)

    @property
    def score(self) -> float:
        """Fault score: the sum of (1 + margin / 10) over the failed checks."""
        return sum(1.0 + 0.1 * check.margin for check in self.checks if check.failed)

    def to_json(self) -> str:
        """Return JSON text; equal verdicts give equal bytes."""
        return self.model_dump_json(indent=1) + "\n"


SCENE_FAULTS = frozenset({Fault.OFF_BALANCE, Fault.TOPPLES, Fault.DRIFTS, Fault.RESTLESS})
"""Faults of falls that a valid object may have if it is tested on a level floor without its scene.

For example, the object is round, or is supported by its surroundings in the scene.
"""


def with_waived_falls(verdict: Verdict) -> Verdict:
    """Return the verdict with failed falls skipped whose fault is one of `SCENE_FAULTS`.

    This is for objects that the critic judges to be valid.
    """
    checks = tuple(
        check.model_copy(update={"outcome": "SKIP", "fault": None, "hint": WAIVER_HINT})
        if check.scenario == "free_fall" and check.outcome == "FAIL" and check.fault in SCENE_FAULTS
        else check
        for check in verdict.checks
    )
    return verdict.model_copy(
        update={"checks": checks, "passed": not any(check.failed for check in checks)}
    )


WAIVER_HINT = "the critic finds that the real object would do the same"
"""Hint of a waived check. The check's value and threshold remain unchanged."""


@dataclass(frozen=True)
class Limit:
    """Threshold of a check, and the fault that is reported if the threshold is violated."""

    threshold: float
    unit: str
    fault: Fault
    least: bool = False
    """True if the threshold is the smallest valid value; False if it is the largest."""
    best: float | None = None
    """Best value; if None, it is 0, or twice the threshold if `least` is True."""
    hint: str = ""
    """Hint that says how to remedy a violation; if empty, the hint of the fault applies."""

    def is_borderline(self, value: float) -> bool:
        """Return True if a passing value is close to the threshold; see `BORDERLINE`."""
        best = self.best if self.best is not None else 2 * self.threshold * self.least
        distance = self.threshold - best
        return bool(distance) and (value - best) / distance >= BORDERLINE


def make_check(
    scenario: ScenarioKind, name: str, value: float, limit: Limit, **context: Any
) -> Check:
    """Compare a value with a limit, and return the check; a value that is not finite fails.

    Args:
        scenario: scenario of the check.
        name: name of the check.
        value: the measured value.
        limit: the threshold and the fault.
        context: other fields of `Check`. Of these, `time`, `at` and `evidence` are stored only in
            failed and borderline checks.
    """
    finite = bool(np.isfinite(value))
    passed = finite and (value >= limit.threshold if limit.least else value <= limit.threshold)
    borderline = passed and limit.is_borderline(value)
    details = ("time", "at", "evidence") if passed and not borderline else ()
    return Check(
        scenario=scenario,
        name=name,
        outcome="PASS" if passed else "FAIL",
        borderline=borderline,
        fault=None if passed else limit.fault,
        value=float(value) if finite else None,
        threshold=limit.threshold,
        unit=limit.unit,
        hint="" if passed else limit.hint or limit.fault.hint,
        **{key: field for key, field in context.items() if key not in details},
    )


BUDGET = "budget"
"""Name of the check that is skipped if an object has too many parts and joints for one test."""


def skipped(scenario: ScenarioKind, name: str, reason: str, joint: str | None = None) -> Check:
    """Return a check with the outcome SKIP, and with the reason as its hint."""
    return Check(scenario=scenario, name=name, outcome="SKIP", joint=joint, hint=reason)

"""The result of an object's tests: checks with numbers, the faults they report, and the verdict."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal

import numpy as np
from pydantic import AliasChoices, ConfigDict, Field

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
    "tilt_until_slide",
]


class Fault(StrEnum):
    """Faults that the object tests report, likely causes before symptoms."""

    hint: str
    """How to remedy it."""

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
    OFF_BALANCE = "off_balance", "move the centre of mass over the base, or widen the base"
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
    TOPPLES = "topples", "lower the centre of mass or widen the base"
    DRIFTS = "drifts", "widen or flatten the base"
    RESTLESS = "restless", "add damping; look for colliders that push against each other"


BORDERLINE = 0.8
"""Share of the distance from the best value to the threshold beyond which a passing value is
borderline: a different time step or processor, or a small added load, changes it by about 20 %."""


class Check(Spec):
    """Result of one check, with the number that decides it."""

    model_config = ConfigDict(serialize_by_alias=True)

    scenario: ScenarioKind
    name: str
    outcome: Outcome
    borderline: bool = Field(
        default=False,
        validation_alias=AliasChoices("borderline", "doubtful"),
        serialization_alias="doubtful",
    )
    """True if it passes close to its threshold."""
    fault: Fault | None = None
    """The fault of a failed check."""
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
    """Description of the run or pose that shows the value."""
    hint: str = ""

    @property
    def failed(self) -> bool:
        """True if it failed or could not be evaluated."""
        return self.outcome in ("FAIL", "TOOL_FAILURE")

    @property
    def least(self) -> bool:
        """True if the threshold is the smallest valid value, otherwise it is the largest."""
        if self.value is None or self.threshold is None:
            return False
        return (self.value > self.threshold) == (self.outcome == "PASS")

    def phrase(self) -> str:
        """Return value and bound with unit and direction: "drift 12.0 mm, at most 10.0 mm"."""
        name = self.name.replace("_", " ")
        if self.threshold is None:
            return name
        value = "not finite" if self.value is None else quantity(self.value, self.unit)
        bound = quantity(self.threshold, self.unit)
        return f"{name} {value}, {'at least' if self.least else 'at most'} {bound}"

    @property
    def margin(self) -> float:
        """Relative excess of a failed check over its threshold, 0 to 9."""
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
    """True if every check ran and none failed."""
    mass_kg: float
    battery: str = ""
    """Version of the object tests."""
    checks: tuple[Check, ...]

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Faults that the checks report, causes first."""
        reported = {check.fault for check in self.checks}
        return tuple(fault for fault in Fault if fault in reported)

    @property
    def borderline(self) -> tuple[Check, ...]:
        """Checks that pass close to their thresholds."""
        return tuple(check for check in self.checks if check.borderline)

    @property
    def questionable(self) -> bool:
        """True if a check failed or passed close to its threshold."""
        return not self.passed or bool(self.borderline)

    @property
    def cause(self) -> Fault | None:
        """The fault that likely explains the others."""
        return next(iter(self.faults), None)

    @property
    def score(self) -> float:
        """Fault score: 0 for a valid object; a failed check adds 1 plus a tenth of its margin."""
        return sum(1.0 + 0.1 * check.margin for check in self.checks if check.failed)

    def to_json(self) -> str:
        """Return JSON, the same bytes for the same verdict."""
        return self.model_dump_json(indent=1) + "\n"


SCENE_FAULTS = frozenset({Fault.OFF_BALANCE, Fault.TOPPLES, Fault.DRIFTS, Fault.RESTLESS})
"""Faults of falls that a valid object may have on a level floor without its scene: it is round, or
its surroundings hold it."""


def waived(verdict: Verdict) -> Verdict:
    """Skip failed falls whose fault is one of `SCENE_FAULTS`, for an object judged to be valid."""
    checks = tuple(
        check.model_copy(update={"outcome": "SKIP", "fault": None, "hint": WAIVED})
        if check.scenario == "free_fall" and check.outcome == "FAIL" and check.fault in SCENE_FAULTS
        else check
        for check in verdict.checks
    )
    return verdict.model_copy(
        update={"checks": checks, "passed": not any(check.failed for check in checks)}
    )


WAIVED = "the critic finds that the real object would do the same"
"""Hint of a waived check, which keeps its value and threshold."""


def quantity(value: float, unit: str) -> str:
    """Format the value of a check: lengths in mm, angles in degrees, fractions in percent."""
    if unit.startswith("of "):
        percent = 100 * value
        return f"{percent:.0f} % {unit}" if abs(percent) >= 100 else f"{percent:.3g} % {unit}"
    factor, shown = {
        "m": (1000.0, "mm"),
        "rad": (180 / np.pi, "degrees"),
        "deg": (1.0, "degrees"),
    }.get(unit, (1.0, unit))
    value *= factor
    size = abs(value)
    digits = f"{value:.1f}" if 0.1 <= size < 1000 else f"{value:.1g}" if size >= 1e-3 else "0"
    if size >= 1000:
        digits = f"{value:.0f}"
    return f"{digits} {shown}".strip()


@dataclass(frozen=True)
class Limit:
    """Threshold of a check, and the fault that a violation is reported as."""

    threshold: float
    unit: str
    fault: Fault
    least: bool = False
    """True if the threshold is the smallest valid value, otherwise it is the largest."""
    best: float | None = None
    """Ideal value; by default 0, or twice the threshold if `least` is set."""
    hint: str = ""
    """Remedy of a violation, if not that of the fault."""

    def is_borderline(self, value: float) -> bool:
        """Return True if a passing value lies close to the threshold, seen from the best value."""
        best = self.best if self.best is not None else 2 * self.threshold * self.least
        distance = self.threshold - best
        return bool(distance) and (value - best) / distance >= BORDERLINE


def judged(scenario: ScenarioKind, name: str, value: float, limit: Limit, **context: Any) -> Check:
    """Compare a value with its limit; a value that is not finite fails.

    Args:
        scenario: scenario of the check.
        name: name of the check.
        value: the measured value.
        limit: the threshold and its fault.
        context: further fields of `Check`; only failed and borderline checks keep `time`, `at` and
            `evidence`.
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


def skipped(scenario: ScenarioKind, name: str, reason: str, joint: str | None = None) -> Check:
    """Return a check that was not run, with the reason."""
    return Check(scenario=scenario, name=name, outcome="SKIP", joint=joint, hint=reason)

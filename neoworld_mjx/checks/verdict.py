"""Checks with numbers, the closed list of faults, and the verdict on an object."""

from enum import StrEnum
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

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
    """Faults that the battery reports, likely causes before symptoms."""

    COLLIDER_LARGE = "collider_large"
    COLLIDER_MISSING = "collider_missing"
    INERTIA_IMPOSSIBLE = "inertia_impossible"
    MASS_IMPLAUSIBLE = "mass_implausible"
    JOINT_TYPE = "joint_type"
    AXIS_REVERSED = "axis_reversed"
    PART_DETACHED = "part_detached"
    PARTS_OVERLAP = "parts_overlap"
    PIVOT_OFF = "pivot_off"
    JOINT_INTO_PART = "joint_into_part"
    LIMIT_INTO_PART = "limit_into_part"
    RANGE_CONFLICT = "range_conflict"
    LIMITS_NARROW = "limits_narrow"
    OFF_BALANCE = "off_balance"
    FRICTION_IMPLAUSIBLE = "friction_implausible"
    JOINT_UNDAMPED = "joint_undamped"
    JOINT_STUCK = "joint_stuck"
    JOINT_MOVES_ITSELF = "joint_moves_itself"
    LIMIT_SOFT = "limit_soft"
    DIVERGES = "diverges"
    GAINS_ENERGY = "gains_energy"
    SINKS_IN = "sinks_in"
    TOPPLES = "topples"
    DRIFTS = "drifts"
    RESTLESS = "restless"


DOUBT = 0.8
"""Share of the distance from the best value to the threshold beyond which a passing value is
doubtful: another time step or processor, or a little more load, changes such values by a fifth."""
RANK = {fault: place for place, fault in enumerate(Fault)}
"""Order in which one fault explains another; the first is reported as the cause."""

HINTS: dict[Fault, str] = {
    Fault.INERTIA_IMPOSSIBLE: "recompute the inertia from volume and density",
    Fault.MASS_IMPLAUSIBLE: "leave the mass to volume and density, or make the part hollow",
    Fault.JOINT_TYPE: "give the joint the type that it is meant to have",
    Fault.AXIS_REVERSED: "reverse the axis: positive opens",
    Fault.COLLIDER_MISSING: "let what is seen collide as well",
    Fault.COLLIDER_LARGE: "shrink the colliders to what is seen",
    Fault.PART_DETACHED: "move the part to what its joint attaches it to",
    Fault.PARTS_OVERLAP: "move the parts apart, or shrink their colliders",
    Fault.PIVOT_OFF: "put the pivot on the edge that both parts share",
    Fault.JOINT_INTO_PART: "check axis and sign; it runs into another part at once",
    Fault.LIMIT_INTO_PART: "cut the limits to the range that is free",
    Fault.RANGE_CONFLICT: "leave room for several joints that are open at once",
    Fault.LIMITS_NARROW: "widen the limits to the range that the thing has",
    Fault.OFF_BALANCE: "bring the centre of mass over the base, or widen the base",
    Fault.FRICTION_IMPLAUSIBLE: "give the surface the friction of its material, 0.1 to 1.2",
    Fault.JOINT_UNDAMPED: "give the joint damping or dry friction",
    Fault.JOINT_STUCK: "lower friction, damping or stiffness, or free the joint's way",
    Fault.JOINT_MOVES_ITSELF: "colliders press on it: leave them air",
    Fault.LIMIT_SOFT: "lower mass or speed, or widen the limits",
    Fault.DIVERGES: "check masses, inertias and overlapping colliders",
    Fault.GAINS_ENERGY: "colliders overlap or joints fight",
    Fault.SINKS_IN: "check mass and colliders",
    Fault.TOPPLES: "lower the centre of mass or widen the base",
    Fault.DRIFTS: "widen or flatten the base",
    Fault.RESTLESS: "add damping; look for colliders that fight",
}


class Check(Spec):
    """Result of one check, with the number that decided it."""

    scenario: ScenarioKind
    name: str
    outcome: Outcome
    doubtful: bool = False
    """Whether it passed close to its threshold."""
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
    """The run or pose that shows the value, in words; key frames of a run can be drawn."""
    hint: str = ""

    @property
    def margin(self) -> float:
        """Relative excess of a failed check over its threshold, 0 to 9."""
        if self.outcome == "TOOL_FAILURE":
            return 9.0
        if self.outcome != "FAIL":
            return 0.0
        if self.value is None or not self.threshold:
            return 1.0
        ratio = abs(self.value - self.threshold) / abs(self.threshold)
        return float(min(ratio, 9.0))


class Verdict(Spec):
    """Results of all checks of one object."""

    object: str
    passed: bool
    """Whether every check ran and none failed."""
    mass_kg: float
    battery: str = ""
    """Version of the battery."""
    checks: tuple[Check, ...]

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Each fault that a check reports, once, causes first."""
        reported = {check.fault for check in self.checks if check.fault is not None}
        return tuple(sorted(reported, key=RANK.__getitem__))

    @property
    def doubtful(self) -> tuple[Check, ...]:
        """Checks that passed close to their thresholds."""
        return tuple(check for check in self.checks if check.doubtful)

    @property
    def cause(self) -> Fault | None:
        """The fault that likely explains the others."""
        return self.faults[0] if self.faults else None

    @property
    def score(self) -> float:
        """Fault score: 0 is valid; each failed check adds 1 and a tenth of its margin."""
        bad = [check for check in self.checks if check.outcome in ("FAIL", "TOOL_FAILURE")]
        return sum(1.0 + 0.1 * check.margin for check in bad)

    def to_json(self) -> str:
        """Return JSON, the same bytes for the same verdict."""
        return self.model_dump_json(indent=1) + "\n"


class Limit(BaseModel):
    """Threshold of a check, and the fault of exceeding it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    threshold: float
    unit: str
    fault: Fault
    least: bool = False
    """Whether the value must be at least the threshold, rather than at most."""
    best: float | None = None
    """Ideal value; by default 0, or twice the threshold where `least` is set."""

    def doubts(self, value: float) -> bool:
        """Tell whether a passing value lies close to the threshold, seen from the best value."""
        best = self.best if self.best is not None else 2 * self.threshold * self.least
        room = self.threshold - best
        return bool(room) and (value - best) / room >= DOUBT


def judged(
    scenario: ScenarioKind,
    name: str,
    value: float,
    limit: Limit,
    *,
    part: str | None = None,
    joint: str | None = None,
    time: float | None = None,
    at: float | None = None,
    evidence: str = "",
) -> Check:
    """Compare a value with its limit; a value that is not finite fails.

    Only failed and doubtful checks keep the time, position and evidence.
    """
    finite = bool(np.isfinite(value))
    good = finite and (value >= limit.threshold if limit.least else value <= limit.threshold)
    doubtful = good and limit.doubts(value)
    dull = good and not doubtful
    return Check(
        scenario=scenario,
        name=name,
        outcome="PASS" if good else "FAIL",
        doubtful=doubtful,
        fault=None if good else limit.fault,
        value=float(value) if finite else None,
        threshold=limit.threshold,
        unit=limit.unit,
        part=part,
        joint=joint,
        time=None if dull or time is None else float(time),
        at=None if dull or at is None else float(at),
        evidence="" if dull else evidence,
        hint="" if good else HINTS[limit.fault],
    )


def skipped(scenario: ScenarioKind, name: str, reason: str, joint: str | None = None) -> Check:
    """Return a check that was not run, with the reason."""
    return Check(scenario=scenario, name=name, outcome="SKIP", joint=joint, hint=reason)

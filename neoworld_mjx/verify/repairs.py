"""Direct repairs: patches that are derived from measurements and accepted only if they help.

Each round addresses the likeliest cause with one patch, and accepts it if it lowers the fault score
and adds no fault. Direct repairs send no requests to models. `Repair.try_patch` also applies this
rule to patches that a model proposes. `Repair.try_program` accepts a new program if it lowers the
fault score.
"""

import json
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks.joint_checks import pivot_edges
from ..checks.object_tests import ObjectTests
from ..checks.static_checks import Probe
from ..checks.verdict import WAIVER_HINT, Check, Fault, Verdict, with_waived_falls
from ..errors import SpecError
from ..program.ask import SynthesisResult
from ..program.assemble import SETTLING_S, default_losses
from ..spec import JointSpec, ObjectSpec, PartSpec, inertial, part_bounds
from ..spec.pose import triple
from .patch import GeomEdit, JointEdit, PartEdit, Patch, apply

GAP_M = 0.0005
"""Gap that a repair leaves between parts that it moves apart or together [m]."""
GAIN = 0.05
"""A patch or a new program is accepted only if it lowers the fault score by more than this."""


RunTests = Callable[..., ObjectTests]
"""Runs the object tests of an object. Its keyword `allowed` replaces the overlaps that the first
program declares."""


@dataclass
class Repair:
    """Repair of an object: the accepted patch or new program, and the test results with it.

    `try_patch`, `try_program` and `waive` update the repair.
    """

    original: ObjectSpec
    """The object without the patch."""
    run: RunTests
    tests: ObjectTests
    """Test results of the object with `patch`."""
    before: Verdict
    """Verdict on the first program's object without a patch."""
    patch: Patch = field(default_factory=Patch)
    """The accepted patch."""
    tried: list[str] = field(default_factory=list)
    """Description of every patch that was tried, with the fault score before and after."""
    seen: list[str] = field(default_factory=list)
    """The critic's findings in the key frames."""
    lost_critics: list[tuple[str, str]] = field(default_factory=list)
    """Pairs of a request that a model failed to answer, and the reason."""
    program: SynthesisResult | None = None
    """The new program that built `original`; None if the first program built it."""
    unmet: list[str] = field(default_factory=list)
    """Findings for which the critic asked for a new program that could not be requested."""

    @property
    def spec(self) -> ObjectSpec:
        """The object with the accepted patch."""
        return self.tests.spec

    @property
    def verdict(self) -> Verdict:
        """Verdict on the object with the accepted patch."""
        return self.tests.verdict

    @property
    def changed(self) -> bool:
        """True if the object has a new program or a patch."""
        return self.program is not None or not self.patch.empty

    @property
    def waived(self) -> tuple[Check, ...]:
        """Failed checks that the critic waived."""
        return tuple(check for check in self.verdict.checks if check.hint == WAIVER_HINT)

    def to_json(self) -> str:
        """Return the verdict as JSON, with changes, tried patches and the critic's findings."""
        data = self.verdict.model_dump(mode="json")
        data |= {"changes": self.patch.changes(), "tried": self.tried, "seen": self.seen}
        return json.dumps(data, indent=1) + "\n"

    def try_patch(self, patch: Patch) -> bool:
        """Try a patch on top of the accepted patch; return True if it helps and is accepted."""
        previous_score, merged = self.verdict.score, self.patch.merged_with(patch)
        description = "; ".join(patch.changes())
        try:
            changed, _ = apply(merged, self.original)
        except SpecError as error:
            self.tried.append(f"{description}: {error}")
            return False
        tests = self.run(changed)
        score, faults = tests.verdict.score, set(tests.verdict.faults)
        self.tried.append(f"{description}: fault score {previous_score:.2f} to {score:.2f}")
        helps = score < previous_score - GAIN and faults.issubset(self.verdict.faults)
        if helps:
            self.patch, self.tests = merged, tests
        return helps

    def try_program(self, result: SynthesisResult) -> bool:
        """Replace the object by that of a new program if the fault score decreases.

        Returns:
            True if the object was replaced.
        """
        previous_score = self.verdict.score
        if result.spec is None:
            self.tried.append(f"new program: {result.reason}")
            return False
        run = partial(self.run, allowed=result.allowances)
        candidate = repair(result.spec, run)
        self.tried.append(
            f"new program: fault score {previous_score:.2f} to {candidate.verdict.score:.2f}"
        )
        if candidate.verdict.score >= previous_score - GAIN:
            return False
        self.tried += candidate.tried
        self.original, self.run, self.program = candidate.original, run, result
        self.patch, self.tests = candidate.patch, candidate.tests
        return True

    def waive(self) -> None:
        """Waive checks that fail only because the object is tested without its scene."""
        self.tests = replace(self.tests, verdict=with_waived_falls(self.verdict))


def repair(spec: ObjectSpec, run: RunTests, *, rounds: int = 6) -> Repair:
    """Repair an object with patches that are derived from measurements.

    Args:
        spec: the object.
        run: runs the object tests.
        rounds: largest number of rounds, each of which addresses one cause.
    """
    tests = run(spec)
    repaired = Repair(spec, run, tests, tests.verdict)
    given_up: set[tuple[Fault | None, str]] = set()
    for _ in range(rounds):
        check = _likeliest_cause(repaired.verdict, given_up)
        if check is None:
            break
        patch = proposal(repaired.tests, check)
        if patch is None or not repaired.try_patch(patch):
            given_up.add((check.fault, check.name))
    return repaired


def _likeliest_cause(
    verdict: Verdict, given_up: Collection[tuple[Fault | None, str]]
) -> Check | None:
    """Return the first failed check of the likeliest repairable fault, or None.

    Checks in `given_up` are excluded.
    """
    for fault in verdict.faults:
        for check in verdict.checks:
            repairable = fault in _PART_REPAIRS or fault in _JOINT_REPAIRS
            if check.fault is fault and repairable and (fault, check.name) not in given_up:
                return check
    return None


def proposal(tests: ObjectTests, check: Check) -> Patch | None:
    """Return the patch that could repair a failed check; None if no measurement gives one."""
    if check.fault in _PART_REPAIRS and check.part is not None:
        return _PART_REPAIRS[check.fault](tests, tests.spec.part(check.part))
    if check.fault in _JOINT_REPAIRS and check.joint is not None:
        return _JOINT_REPAIRS[check.fault](tests, tests.spec.joint(check.joint))
    return None


def _derive_inertia(_: ObjectTests, part: PartSpec) -> Patch:
    return Patch(parts={part.name: PartEdit(inertia="derived")})


def _derive_mass(_: ObjectTests, part: PartSpec) -> Patch:
    return Patch(parts={part.name: PartEdit(mass="derived")})


def _collide_as_seen(_: ObjectTests, part: PartSpec) -> Patch:
    visible = [geom.name for geom in part.geoms if geom.role != "collision"]
    return Patch(geoms={name: GeomEdit(as_seen=True) for name in visible})


def _cut_limits(tests: ObjectTests, joint: JointSpec) -> Patch | None:
    """Reduce the joint's range to the collision-free range."""
    low, high = tests.joint_checks.free.get(joint.name, (0.0, 0.0))
    # Rounding must not widen the range. A ball joint without a limit has an upper limit of 0.
    upper = high if joint.type == "ball" else min(high, joint.upper)
    return _edited(joint, lower=max(low, joint.lower), upper=upper) if low < high else None


def _widen_limits(_: ObjectTests, joint: JointSpec) -> Patch | None:
    """Widen the range at the upper end to the declared travel."""
    if joint.intent is None or joint.intent.travel is None:
        return None
    return _edited(joint, upper=joint.lower + joint.intent.travel)


def _add_losses(tests: ObjectTests, joint: JointSpec) -> Patch:
    """Raise dry friction and damping to their defaults; more damping for a joint with a spring."""
    damping, friction = _losses(tests, joint)
    if joint.stiffness > 0:
        damping = max(damping, 2 * float(np.sqrt(joint.stiffness * damping * SETTLING_S)))
    raised = max(joint.damping, damping), max(joint.friction, friction)
    return _edited(joint, damping=raised[0], friction=raised[1])


def _cut_losses(tests: ObjectTests, joint: JointSpec) -> Patch:
    """Lower damping and dry friction to their defaults."""
    damping, friction = _losses(tests, joint)
    lowered = min(joint.damping, damping), min(joint.friction, friction)
    return _edited(joint, damping=lowered[0], friction=lowered[1])


def _move_pivot(tests: ObjectTests, joint: JointSpec) -> Patch:
    """Move the pivot to the nearest edge of the child, or to the child's center."""
    low, high = part_bounds(tests.spec, tests.spec.part(joint.child))
    middle = (low + high) / 2
    pivot, axis = np.array(joint.pos), np.array(joint.axis)
    # Hinges lie near the parent.
    near_parent = np.clip(middle, *part_bounds(tests.spec, tests.spec.part(joint.parent)))

    def radial_distance(offset: NDArray) -> float:
        return float(np.linalg.norm(offset - (offset @ axis) * axis))

    def distance(edge: NDArray) -> float:
        return radial_distance(edge - pivot) + 0.5 * radial_distance(edge - near_parent)

    edges = [] if joint.type == "continuous" else pivot_edges(joint, low, high)
    position = min(edges, key=distance, default=middle)
    axial_offset = ((pivot - position) @ axis) * axis
    return _edited(joint, origin=triple(position + axial_offset))


def _close_gap(tests: ObjectTests, joint: JointSpec) -> Patch:
    """Move a detached part to its parent, along the axis on which they are farthest apart."""
    low, high = part_bounds(tests.spec, tests.spec.part(joint.child))
    lowest, highest = part_bounds(tests.spec, tests.spec.part(joint.parent))
    gaps = np.maximum(low - highest, lowest - high)
    axis, shift = int(np.argmax(gaps)), np.zeros(3)
    shift[axis] = -(gaps[axis] - GAP_M) * (1.0 if low[axis] > highest[axis] else -1.0)
    return _shifted(joint.child, shift)


def _separate(tests: ObjectTests, part: PartSpec) -> Patch | None:
    """Move a part out of the part that it overlaps, by the shortest shift.

    A shift along the line of the smallest distance changes this line, so the shift is found in up
    to 8 steps.
    """
    spec = tests.spec
    pair = next((p for p in tests.joint_checks.overlapping if part.name in p[:2]), None)
    if pair is None:
        return None
    other, child, _ = pair
    if all(joint.child != child for joint in spec.joints):
        child, other = other, child
    shift = np.zeros(3)
    for _ in range(8):
        probe = Probe(apply(_shifted(child, shift), spec)[0])
        gap, direction = probe.separation(probe.names.index(other), probe.names.index(child))
        if gap >= 0.5 * GAP_M:
            break
        shift = shift + direction * (GAP_M - gap)
    return _shifted(child, shift)


def _shifted(part: str, shift: NDArray) -> Patch:
    return Patch(parts={part: PartEdit(shift=triple(shift))})


def _edited(joint: JointSpec, **fields: Any) -> Patch:
    return Patch(joints={joint.name: JointEdit(**fields)})


def _losses(tests: ObjectTests, joint: JointSpec) -> tuple[float, float]:
    """Return the default damping and dry friction of a joint."""
    child = tests.spec.part(joint.child)
    return default_losses(joint, inertial(tests.spec, child))


_PART_REPAIRS: dict[Fault | None, Callable[[ObjectTests, PartSpec], Patch | None]] = {
    Fault.INERTIA_IMPOSSIBLE: _derive_inertia,
    Fault.MASS_IMPLAUSIBLE: _derive_mass,
    Fault.COLLIDER_MISSING: _collide_as_seen,
    Fault.COLLIDER_LARGE: _collide_as_seen,
    Fault.PARTS_OVERLAP: _separate,
}
_JOINT_REPAIRS: dict[Fault | None, Callable[[ObjectTests, JointSpec], Patch | None]] = {
    Fault.LIMIT_INTO_PART: _cut_limits,
    Fault.LIMITS_NARROW: _widen_limits,
    Fault.JOINT_UNDAMPED: _add_losses,
    Fault.LIMIT_SOFT: _add_losses,
    Fault.RESTLESS: _add_losses,
    Fault.JOINT_STUCK: _cut_losses,
    Fault.PIVOT_OFF: _move_pivot,
    Fault.PART_DETACHED: _close_gap,
}

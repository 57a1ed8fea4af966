"""Direct repairs: patches that are derived from measurements and accepted only if they help.

Each round addresses the likeliest cause. It runs the object tests with each of a few patches, and
accepts the best patch that lowers the fault score and adds no fault. Direct repairs send no
requests to models. `Repair.try_patches` also applies this rule to patches that a model proposes.
`Repair.try_program` accepts a new program if it lowers the fault score.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..checks.joint_checks import on_edge, pivot_edges
from ..checks.object_tests import ObjectTests
from ..checks.signals import Allowance
from ..checks.static_checks import Probe
from ..checks.verdict import Check, Fault, Verdict, with_waived_falls
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


@runtime_checkable
class RunTests(Protocol):
    """Function that runs the object tests.

    By default, the overlaps that the first program declares are allowed.
    """

    def __call__(self, spec: ObjectSpec, /, *, allowed: Sequence[Allowance] = ...) -> ObjectTests:
        """Return the results of the object tests."""
        ...


@dataclass
class Repair:
    """State of the repair of an object: the accepted patch, and the results with this patch.

    `try_patches`, `try_program` and `waive` update the state.
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
    lost_critics: list[tuple[str, str]] = field(default_factory=list)
    """Pairs of a request that a model failed to answer, and the reason."""
    program: SynthesisResult | None = None
    """The new program that built `original`; None if the first program built it."""
    unfulfilled: list[str] = field(default_factory=list)
    """Findings for which the critic asked for a new program that could not be requested."""

    @property
    def after(self) -> Verdict:
        """Verdict on the object with the accepted patch."""
        return self.tests.verdict

    def try_patches(self, patches: Iterable[Patch]) -> bool:
        """Try each patch on top of the accepted patch, and accept the best patch that helps.

        Returns:
            True if a patch was accepted.
        """
        best: tuple[float, Patch, ObjectTests] | None = None
        previous_score, known_faults = self.after.score, set(self.after.faults)
        for patch in patches:
            merged = self.patch.merged_with(patch)
            description = "; ".join(patch.changes())
            try:
                changed, _ = apply(merged, self.original)
            except SpecError as error:
                self.tried.append(f"{description}: {error}")
                continue
            tests = self.run(changed)
            score = tests.verdict.score
            self.tried.append(f"{description}: fault score {previous_score:.2f} to {score:.2f}")
            helps = score < previous_score - GAIN and known_faults.issuperset(tests.verdict.faults)
            if helps and (best is None or score < best[0]):
                best = (score, merged, tests)
            if tests.verdict.passed:
                break
        if best is not None:
            _, self.patch, self.tests = best
        return best is not None

    def try_program(self, result: SynthesisResult, *, rounds: int = 6) -> bool:
        """Replace the object by that of a new program if the fault score decreases.

        Args:
            result: the new program.
            rounds: largest number of rounds of direct repairs of the new object.

        Returns:
            True if the object was replaced.
        """
        previous_score = self.after.score
        if result.spec is None:
            self.tried.append(f"new program: {result.reason}")
            return False
        run = partial(self.run, allowed=result.allowances)
        candidate = repair(result.spec, run, rounds=rounds)
        self.tried.append(
            f"new program: fault score {previous_score:.2f} to {candidate.after.score:.2f}"
        )
        if candidate.after.score >= previous_score - GAIN:
            return False
        self.tried += candidate.tried
        self.original, self.run, self.program = candidate.original, run, result
        self.patch, self.tests = candidate.patch, candidate.tests
        return True

    def waive(self) -> None:
        """Waive checks that fail only because the object is tested without its scene."""
        self.tests = replace(self.tests, verdict=with_waived_falls(self.after))


def repair(
    spec: ObjectSpec, run: RunTests, *, rounds: int = 6, first: ObjectTests | None = None
) -> Repair:
    """Repair an object with patches that are derived from measurements.

    Args:
        spec: the object.
        run: runs the object tests.
        rounds: largest number of rounds, each of which addresses one cause.
        first: test results of `spec`; if None, the tests are run.
    """
    tests = first or run(spec)
    repaired = Repair(spec, run, tests, tests.verdict)
    given_up: set[tuple[Fault | None, str]] = set()
    for _ in range(rounds):
        check = _likeliest_cause(repaired.after, given_up)
        if check is None:
            break
        if not repaired.try_patches(proposals(repaired.tests, check)):
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


def proposals(tests: ObjectTests, check: Check) -> Iterator[Patch]:
    """Yield patches that could repair a failed check, the most promising first."""
    if check.fault in _PART_REPAIRS and check.part is not None:
        yield from _PART_REPAIRS[check.fault](tests, tests.spec.part(check.part))
    elif check.fault in _JOINT_REPAIRS and check.joint is not None:
        yield from _JOINT_REPAIRS[check.fault](tests, tests.spec.joint(check.joint))


def _derive_inertia(tests: ObjectTests, part: PartSpec) -> Iterator[Patch]:
    yield Patch(parts={part.name: PartEdit(inertia="derived")})
    yield from _derive_mass(tests, part)


def _derive_mass(_: ObjectTests, part: PartSpec) -> Iterator[Patch]:
    yield Patch(parts={part.name: PartEdit(mass="derived")})


def _collide_as_seen(_: ObjectTests, part: PartSpec) -> Iterator[Patch]:
    visible = [geom.name for geom in part.geoms if geom.role != "collision"]
    yield Patch(geoms={name: GeomEdit(as_seen=True) for name in visible})


def _cut_limits(tests: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Reduce the joint's range to the collision-free range."""
    if joint.name not in tests.joint_checks.free:
        return
    low, high = tests.joint_checks.free[joint.name]
    # Rounding must not widen the range. A ball joint without a limit has an upper limit of 0.
    upper = high if joint.type == "ball" else min(high, joint.upper)
    if low < high:
        yield _edited(joint, JointEdit(lower=max(low, joint.lower), upper=upper))


def _widen_limits(_: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Widen the range to the declared travel, at the upper or at the lower end."""
    if joint.intent is None or joint.intent.travel is None:
        return
    travel = joint.intent.travel
    yield _edited(joint, JointEdit(upper=joint.lower + travel))
    yield _edited(joint, JointEdit(lower=joint.upper - travel))


def _add_losses(tests: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Raise dry friction to its default, and damping to one or four times its default.

    For a joint with a spring, the default damping is increased.
    """
    damping, friction = _losses(tests, joint)
    if joint.stiffness > 0:
        damping = max(damping, 2 * float(np.sqrt(joint.stiffness * damping * SETTLING_S)))
    friction = max(joint.friction, friction)
    for factor in (1.0, 4.0):
        raised = max(joint.damping, factor * damping)
        yield _edited(joint, JointEdit(damping=raised, friction=friction))


def _cut_losses(tests: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Lower damping and dry friction to their defaults."""
    damping, friction = _losses(tests, joint)
    damping, friction = min(joint.damping, damping), min(joint.friction, friction)
    yield _edited(joint, JointEdit(damping=damping, friction=friction))


def _move_pivot(tests: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Move the pivot to an edge of the child, the nearest edge first, or to the child's center."""
    low, high = part_bounds(tests.spec, tests.spec.part(joint.child))
    middle = (low + high) / 2
    pivot, axis = np.array(joint.pos), np.array(joint.axis)
    # Hinges lie near the parent.
    near_parent = np.clip(middle, *part_bounds(tests.spec, tests.spec.part(joint.parent)))

    def radial_distance(offset: NDArray) -> float:
        return float(np.linalg.norm(offset - (offset @ axis) * axis))

    def distance(edge: NDArray) -> float:
        return radial_distance(edge - pivot) + 0.5 * radial_distance(edge - near_parent)

    positions = sorted(pivot_edges(joint, low, high), key=distance)
    if joint.type == "continuous" or not positions:
        positions = [middle]
    elif not on_edge(joint, low, high):
        positions.append(middle)
    for position in positions[:4]:
        axial_offset = ((pivot - position) @ axis) * axis
        yield _edited(joint, JointEdit(origin=triple(position + axial_offset)))


def _close_gap(tests: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Move a detached part to its parent, along one axis or along the shortest path."""
    spec, child = tests.spec, joint.child
    shortest = _shift_to_gap(spec, child, joint.parent, lambda gap: abs(gap - GAP_M) < 1e-4)
    low, high = part_bounds(spec, spec.part(child))
    lowest, highest = part_bounds(spec, spec.part(joint.parent))
    gaps = np.maximum(low - highest, lowest - high)
    axis = int(np.argmax(gaps))
    straight = np.zeros(3)
    straight[axis] = -(gaps[axis] - GAP_M) * (1.0 if low[axis] > highest[axis] else -1.0)
    for shift in (straight, shortest):
        if np.any(shift):
            yield _shifted(child, shift)


def _separate(tests: ObjectTests, part: PartSpec) -> Iterator[Patch]:
    """Move a part out of the part that it overlaps, or shrink its colliders."""
    spec = tests.spec
    pair = next((p for p in tests.joint_checks.overlapping if part.name in p[:2]), None)
    if pair is None:
        return
    other, child, depth = pair
    if all(joint.child != child for joint in spec.joints):
        child, other = other, child
    shifts = [_shift_to_gap(spec, child, other, lambda gap: gap >= 0.5 * GAP_M)]
    size = max(depth, 1e-3) + GAP_M
    shifts += [sign * size * axis + 0.0 for axis in np.eye(3) for sign in (1.0, -1.0)]
    # Distances are cheap to measure, but the object tests are not, so only shifts that separate
    # the parts are tried.
    free = [shift for shift in shifts if _gap(spec, child, other, shift)[0] > -1e-3]
    free.sort(key=lambda shift: float(np.linalg.norm(shift)))
    for shift in free[:4]:
        yield _shifted(child, shift)
    colliders = [geom.name for geom in spec.part(child).geoms if geom.role != "visual"]
    for factor in (0.97, 0.9):
        yield Patch(geoms={name: GeomEdit(shrink=factor) for name in colliders})


def _shift_to_gap(
    spec: ObjectSpec, part: str, other: str, stop: Callable[[float], bool]
) -> NDArray:
    """Return the shortest shift that leaves a gap of `GAP_M` between two parts [m], shape [3].

    A shift along the line of the smallest distance changes this line, so the shift is found in up
    to 8 steps, until `stop` accepts the gap [m].
    """
    shift = np.zeros(3)
    for _ in range(8):
        gap, direction = _gap(spec, part, other, shift)
        if stop(gap):
            break
        shift = shift + direction * (GAP_M - gap)
    return shift


def _gap(spec: ObjectSpec, part: str, other: str, shift: NDArray) -> tuple[float, NDArray]:
    """Return the signed distance of a shifted part from another part [m], and its direction."""
    probe = Probe(apply(_shifted(part, shift), spec)[0])
    return probe.separation(probe.names.index(other), probe.names.index(part))


def _shifted(part: str, shift: NDArray) -> Patch:
    return Patch(parts={part: PartEdit(shift=triple(shift))})


def _edited(joint: JointSpec, edit: JointEdit) -> Patch:
    return Patch(joints={joint.name: edit})


def _losses(tests: ObjectTests, joint: JointSpec) -> tuple[float, float]:
    """Return the default damping and dry friction of a joint."""
    child = tests.spec.part(joint.child)
    return default_losses(joint, inertial(tests.spec, child))


_PART_REPAIRS: dict[Fault | None, Callable[[ObjectTests, PartSpec], Iterator[Patch]]] = {
    Fault.INERTIA_IMPOSSIBLE: _derive_inertia,
    Fault.MASS_IMPLAUSIBLE: _derive_mass,
    Fault.COLLIDER_MISSING: _collide_as_seen,
    Fault.COLLIDER_LARGE: _collide_as_seen,
    Fault.PARTS_OVERLAP: _separate,
}
_JOINT_REPAIRS: dict[Fault | None, Callable[[ObjectTests, JointSpec], Iterator[Patch]]] = {
    Fault.LIMIT_INTO_PART: _cut_limits,
    Fault.LIMITS_NARROW: _widen_limits,
    Fault.JOINT_UNDAMPED: _add_losses,
    Fault.LIMIT_SOFT: _add_losses,
    Fault.RESTLESS: _add_losses,
    Fault.JOINT_STUCK: _cut_losses,
    Fault.PIVOT_OFF: _move_pivot,
    Fault.PART_DETACHED: _close_gap,
}

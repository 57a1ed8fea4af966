"""Direct repairs: patches proposed from measurements, accepted only if they help.

Each round takes the likeliest cause, tries a few patches against the whole tests, and accepts the
best one that lowers the fault score and adds no new fault. Direct repairs send no request to a
model; `try_patches` applies the same rule to patches that a model proposes.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..checks.joint_checks import on_edge, pivot_edges
from ..checks.object_tests import ObjectTests
from ..checks.part_distances import Probe
from ..checks.verdict import Check, Fault, Verdict
from ..errors import SpecError
from ..program.joint_losses import SETTLING_S, default_losses
from ..spec import JointSpec, ObjectSpec, PartSpec, Vec3, inertial, part_bounds
from .patch import GeomEdit, JointEdit, PartEdit, Patch, apply

GAP_M = 0.0005
"""Gap between parts that a repair moves apart or together."""
GAIN = 0.05
"""Least decrease of the fault score by an accepted patch."""
RunTests = Callable[[ObjectSpec], ObjectTests]


@dataclass
class Repaired:
    """Result of repairing an object."""

    spec: ObjectSpec
    patch: Patch
    before: Verdict
    after: Verdict
    rounds: int = 0
    tried: list[str] = field(default_factory=list)
    """Every patch that was tried: its changes, and the fault score before and after."""
    lost_critics: list[tuple[str, str]] = field(default_factory=list)
    """Requests that a model failed to answer, and why."""

    @property
    def changes(self) -> tuple[str, ...]:
        """Each change, in words."""
        return self.patch.changes()


def repair(
    spec: ObjectSpec, run: RunTests, *, rounds: int = 6, first: ObjectTests | None = None
) -> Repaired:
    """Repair an object by patches that its measurements propose.

    Args:
        spec: the object.
        run: runs the tests on an object.
        rounds: largest number of causes to address.
        first: the tests's result for `spec`, if it exists.
    """
    tests = first or run(spec)
    repaired = Repaired(spec, Patch(), tests.verdict, tests.verdict)
    given_up: set[tuple[Fault | None, str]] = set()
    while repaired.rounds < rounds and not tests.verdict.passed:
        check = _next(tests.verdict, given_up)
        if check is None:
            break
        repaired.rounds += 1
        improved = try_patches(repaired, tests, proposals(tests, check), run, spec)
        if improved is None:
            given_up.add((check.fault, check.name))
        else:
            tests = improved
    return repaired


def try_patches(
    repaired: Repaired,
    tests: ObjectTests,
    patches: Iterable[Patch],
    run: RunTests,
    spec: ObjectSpec,
) -> ObjectTests | None:
    """Try patches on top of the repairs so far, and add the best that helps to them.

    Args:
        repaired: the repairs so far; updated in place.
        tests: the tests's result for them.
        patches: patches to try.
        run: runs the tests on an object.
        spec: the object before all repairs.

    Returns:
        The tests's result with the best patch; None if no patch helps.
    """
    best: tuple[float, Patch, ObjectTests] | None = None
    before, known = tests.verdict.score, set(tests.verdict.faults)
    for patch in patches:
        joined = repaired.patch.joined(patch)
        description = "; ".join(patch.changes())
        try:
            changed, _ = apply(joined, spec)
        except SpecError as error:
            repaired.tried.append(f"{description}: {error}")
            continue
        after = run(changed)
        score = after.verdict.score
        repaired.tried.append(f"{description}: fault score {before:.2f} to {score:.2f}")
        new = set(after.verdict.faults) - known
        if score < before - GAIN and not new and (best is None or score < best[0]):
            best = (score, joined, after)
        if after.verdict.passed:
            break
    if best is None:
        return None
    _, repaired.patch, improved = best
    repaired.spec, repaired.after = improved.spec, improved.verdict
    return improved


def _next(verdict: Verdict, given_up: set[tuple[Fault | None, str]]) -> Check | None:
    """Return the failed check with the likeliest cause that a patch could repair."""
    failed = [
        check
        for check in verdict.checks
        if check.outcome == "FAIL"
        and (check.fault in _PART_REPAIRS or check.fault in _JOINT_REPAIRS)
        and (check.fault, check.name) not in given_up
    ]
    order = {fault: k for k, fault in enumerate(verdict.faults)}
    return min(failed, key=lambda c: order[c.fault], default=None)  # pyright: ignore[reportArgumentType]


def proposals(tests: ObjectTests, check: Check) -> Iterator[Patch]:
    """Yield patches that could repair a failed check, the likeliest first."""
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
    """Cut the range to the part of it that is free of collisions."""
    if joint.name not in tests.joint_checks.free:
        return
    low, high = tests.joint_checks.free[joint.name]
    # Rounding must not cut rest off. A ball without a limit has an upper limit of 0.
    upper = high if joint.type == "ball" else min(high, joint.upper)
    if low < high:
        yield _edited(joint, JointEdit(lower=max(low, joint.lower), upper=upper))


def _widen_limits(_: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Widen the range at either end to the declared travel."""
    if joint.intent is None or joint.intent.travel is None:
        return
    travel = joint.intent.travel
    yield _edited(joint, JointEdit(upper=joint.lower + travel))
    yield _edited(joint, JointEdit(lower=joint.upper - travel))


def _add_losses(tests: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Raise damping and dry friction to their defaults, and damping to four times that."""
    damping, friction = _losses(tests, joint)
    if joint.stiffness > 0:
        damping = max(damping, 2 * float(np.sqrt(joint.stiffness * damping * SETTLING_S)))
    for factor in (1.0, 4.0):
        edit = JointEdit(
            damping=max(joint.damping, factor * damping), friction=max(joint.friction, friction)
        )
        yield _edited(joint, edit)


def _cut_losses(tests: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Lower damping and dry friction to their defaults."""
    damping, friction = _losses(tests, joint)
    yield _edited(
        joint,
        JointEdit(damping=min(joint.damping, damping), friction=min(joint.friction, friction)),
    )


def _move_pivot(tests: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Move the pivot to an edge of the child, the nearest first, or to the axis of a round part."""
    low, high = part_bounds(tests.spec, tests.spec.part(joint.child))
    middle = (low + high) / 2
    pivot, axis = np.array(joint.pos), np.array(joint.axis)
    places = list(pivot_edges(joint, low, high))
    # Hinges lie near the parent.
    near_parent = np.clip(middle, *part_bounds(tests.spec, tests.spec.part(joint.parent)))
    across = lambda v: float(np.linalg.norm(v - (v @ axis) * axis))
    places.sort(key=lambda edge: across(edge - pivot) + 0.5 * across(edge - near_parent))
    if joint.type == "continuous" or not places:
        places = [middle]
    elif not on_edge(joint, low, high):
        places.append(middle)
    for place in places[:4]:
        yield _edited(joint, JointEdit(origin=vec(place + ((pivot - place) @ axis) * axis)))


def _close_gap(tests: ObjectTests, joint: JointSpec) -> Iterator[Patch]:
    """Move a detached part to its parent: straight along one axis, or the shortest way."""
    spec, child = tests.spec, joint.child
    shortest = _shift_to_gap(spec, child, joint.parent, lambda gap: abs(gap - GAP_M) < 1e-4)
    low, high = part_bounds(spec, spec.part(child))
    lowest, highest = part_bounds(spec, spec.part(joint.parent))
    along = np.maximum(low - highest, lowest - high)
    axis = int(np.argmax(along))
    straight = np.zeros(3)
    straight[axis] = -(along[axis] - GAP_M) * (1.0 if low[axis] > highest[axis] else -1.0)
    for shift in (straight, shortest):
        if np.any(shift):
            yield _shifted(child, shift)


def _separate(tests: ObjectTests, part: PartSpec) -> Iterator[Patch]:
    """Move a part out of the part that it overlaps, or shrink its colliders."""
    spec = tests.spec
    pair = next((p for p in tests.joint_checks.overlapping if part.name in p[:2]), None)
    if pair is None:
        return
    first, second, depth = pair
    child, other = first, second
    if any(joint.child == second for joint in spec.joints):
        child, other = second, first
    shifts = [_shift_to_gap(spec, child, other, lambda gap: gap >= 0.5 * GAP_M)]
    size = max(depth, 1e-3) + GAP_M
    shifts += [sign * size * axis + 0.0 for axis in np.eye(3) for sign in (1.0, -1.0)]
    # Measuring a distance is cheap, the tests is not: it tries only shifts that separate them.
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
    """Return the shift [3] m that brings a part to `GAP_M` from another, the shortest way.

    Moving along the line of the smallest distance changes that line, so this takes up to 8 steps,
    until `stop` accepts the gap [m].
    """
    shift = np.zeros(3)
    for _ in range(8):
        gap, direction = _gap(spec, part, other, shift)
        if stop(gap):
            break
        shift = shift + direction * (GAP_M - gap)
    return shift


def _gap(spec: ObjectSpec, part: str, other: str, shift: NDArray) -> tuple[float, NDArray]:
    """Return the signed distance [m] from a shifted part to another, and the direction [3] away."""
    probe = Probe(apply(_shifted(part, shift), spec)[0])
    return probe.separation(probe.names.index(other), probe.names.index(part))


def _shifted(part: str, shift: NDArray) -> Patch:
    return Patch(parts={part: PartEdit(shift=vec(shift))})


def _edited(joint: JointSpec, edit: JointEdit) -> Patch:
    return Patch(joints={joint.name: edit})


def _losses(tests: ObjectTests, joint: JointSpec) -> tuple[float, float]:
    """Return the default damping and dry friction of a joint."""
    child = tests.spec.part(joint.child)
    return default_losses(joint, inertial(tests.spec, child))


def vec(values: NDArray) -> Vec3:
    """Convert an array [3] to a tuple of floats."""
    x, y, z = (float(v) for v in values)
    return x, y, z


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

"""Repair objects by numbers: patches proposed from measurements, kept only if they help.

Each round takes the likeliest cause, tries a few patches against the whole battery, and keeps the
best one that lowers the fault score and brings no new fault. No model is asked; patches that a
model proposes are tried by the same rule (`try_patches`).
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from ..errors import SpecError
from ..program.joint_losses import SETTLING_S, default_losses
from ..program.probe import Probe
from ..spec import JointSpec, ObjectSpec, Vec3, inertial, part_bounds
from .battery import Battery
from .joint_checks import on_edge, pivot_edges
from .patch import GeomEdit, JointEdit, PartEdit, Patch, apply
from .verdict import Check, Fault, Verdict

GAP_M = 0.0005
"""Air that is left between parts that are moved apart or together."""
GAIN = 0.05
"""By how much a patch must lower the fault score."""
RunBattery = Callable[[ObjectSpec], Battery]


@dataclass
class Repaired:
    """Result of repairing an object."""

    spec: ObjectSpec
    patch: Patch
    before: Verdict
    after: Verdict
    rounds: int = 0
    tried: list[str] = field(default_factory=list)
    """Every patch that was tried: what it changes, and the score before and after."""

    @property
    def changes(self) -> tuple[str, ...]:
        """What was changed, in words."""
        return self.patch.changes()


def repair(
    spec: ObjectSpec, run: RunBattery, *, rounds: int = 6, first: Battery | None = None
) -> Repaired:
    """Repair an object as far as numbers say how.

    Args:
        spec: the object.
        run: the battery with its options.
        rounds: how many causes may be gone after.
        first: the battery's run on `spec`, if it has been made.
    """
    now = first or run(spec)
    made = Repaired(spec, Patch(), now.verdict, now.verdict)
    given_up: set[tuple[Fault | None, str]] = set()
    while made.rounds < rounds and not now.verdict.passed:
        check = _next(now.verdict, given_up)
        if check is None:
            break
        made.rounds += 1
        found = try_patches(made, now, proposals(now, check), run, spec)
        if found is None:
            given_up.add((check.fault, check.name))
        else:
            now = found
    return made


def try_patches(
    made: Repaired, now: Battery, patches: Iterable[Patch], run: RunBattery, spec: ObjectSpec
) -> Battery | None:
    """Try patches on top of what was made, and keep the best that helps; None if none does."""
    best: tuple[float, Patch, Battery] | None = None
    before = now.verdict.score
    known = set(now.verdict.faults)
    for patch in patches:
        joined = made.patch.joined(patch)
        what = "; ".join(patch.changes())
        try:
            changed, _ = apply(joined, spec)
        except SpecError as error:
            made.tried.append(f"{what}: {error}")
            continue
        after = run(changed)
        score = after.verdict.score
        made.tried.append(f"{what}: fault score {before:.2f} to {score:.2f}")
        new = set(after.verdict.faults) - known
        if score < before - GAIN and not new and (best is None or score < best[0]):
            best = (score, joined, after)
        if after.verdict.passed:
            break
    if best is None:
        return None
    _, made.patch, battery = best
    made.spec, made.after = battery.spec, battery.verdict
    return battery


def _next(verdict: Verdict, given_up: set[tuple[Fault | None, str]]) -> Check | None:
    bad = [c for c in verdict.checks if c.outcome == "FAIL" and c.fault in _CURES]
    bad = [c for c in bad if (c.fault, c.name) not in given_up]
    order = {fault: k for k, fault in enumerate(verdict.faults)}
    return min(bad, key=lambda c: order[c.fault], default=None)  # pyright: ignore[reportArgumentType]


def proposals(battery: Battery, check: Check) -> Iterator[Patch]:
    """Yield patches that could cure a failed check, the likeliest first."""
    if check.fault in _CURES:
        yield from _CURES[check.fault](battery, check)


def _inertia(_: Battery, check: Check) -> Iterator[Patch]:
    if check.part is not None:
        yield Patch(parts={check.part: PartEdit(inertia="derived")})
        yield Patch(parts={check.part: PartEdit(mass="derived")})


def _mass(_: Battery, check: Check) -> Iterator[Patch]:
    if check.part is not None:
        yield Patch(parts={check.part: PartEdit(mass="derived")})


def _as_seen(battery: Battery, check: Check) -> Iterator[Patch]:
    if check.part is not None:
        part = battery.spec.part(check.part)
        seen = {g.name: GeomEdit(as_seen=True) for g in part.geoms if g.role != "collision"}
        yield Patch(geoms=seen)


def _cut_limits(battery: Battery, check: Check) -> Iterator[Patch]:
    if check.joint is None or check.joint not in battery.joint_checks.free:
        return
    low, high = battery.joint_checks.free[check.joint]
    joint = _joint(battery, check.joint)
    # Rest belongs to the range, and rounding must not take it out.
    # A ball without a limit states 0.
    upper = high if joint.type == "ball" else min(high, joint.upper)
    cut = JointEdit(lower=max(low, joint.lower), upper=upper)
    if low < high:
        yield Patch(joints={joint.name: cut})


def _widen(battery: Battery, check: Check) -> Iterator[Patch]:
    if check.joint is None:
        return
    joint = _joint(battery, check.joint)
    if joint.intent is None or joint.intent.travel is None:
        return
    travel = joint.intent.travel
    yield Patch(joints={joint.name: JointEdit(upper=joint.lower + travel)})
    yield Patch(joints={joint.name: JointEdit(lower=joint.upper - travel)})


def _damp(battery: Battery, check: Check) -> Iterator[Patch]:
    if check.joint is None:
        return
    joint = _joint(battery, check.joint)
    damping, friction = losses(battery.spec, joint)
    if joint.stiffness > 0:
        damping = max(damping, 2 * float(np.sqrt(joint.stiffness * damping * SETTLING_S)))
    for factor in (1.0, 4.0):
        edit = JointEdit(
            damping=max(joint.damping, factor * damping), friction=max(joint.friction, friction)
        )
        yield Patch(joints={joint.name: edit})


def _free(battery: Battery, check: Check) -> Iterator[Patch]:
    if check.joint is not None:
        joint = _joint(battery, check.joint)
        damping, friction = losses(battery.spec, joint)
        edit = JointEdit(
            damping=min(joint.damping, damping), friction=min(joint.friction, friction)
        )
        yield Patch(joints={joint.name: edit})


def _pivot(battery: Battery, check: Check) -> Iterator[Patch]:
    """Put the pivot on an edge of the child, the nearest first; or on the axis of what is round."""
    if check.joint is None:
        return
    joint = _joint(battery, check.joint)
    low, high = part_bounds(battery.spec, battery.spec.part(joint.child))
    middle = (low + high) / 2
    at, axis = np.array(joint.pos), np.array(joint.axis)
    places = list(pivot_edges(joint, low, high))
    # What lies against the parent is where hinges are.
    lowest, highest = part_bounds(battery.spec, battery.spec.part(joint.parent))
    inner = np.clip(middle, lowest, highest)
    across = lambda v: float(np.linalg.norm(v - (v @ axis) * axis))
    places.sort(key=lambda edge: across(edge - at) + 0.5 * across(edge - inner))
    if joint.type == "continuous" or not places:
        places = [middle]
    elif not on_edge(joint, low, high):
        places.append(middle)
    for place in places[:4]:
        origin = place + ((at - place) @ axis) * axis
        yield Patch(joints={joint.name: JointEdit(origin=vec(origin))})


def _together(battery: Battery, check: Check) -> Iterator[Patch]:
    """Move a part that hangs in the air straight to what it hangs on."""
    if check.joint is None:
        return
    joint = _joint(battery, check.joint)
    spec = battery.spec
    moved = np.zeros(3)
    for _ in range(8):
        here, _ = apply(Patch(parts={joint.child: PartEdit(shift=vec(moved))}), spec)
        gap, way = separation(here, joint.parent, joint.child)
        if abs(gap - GAP_M) < 1e-4:
            break
        moved = moved - way * (gap - GAP_M)
    low, high = part_bounds(spec, spec.part(joint.child))
    lowest, highest = part_bounds(spec, spec.part(joint.parent))
    # Straight back along one axis is likelier than the shortest way.
    along = np.maximum(low - highest, lowest - high)
    axis = int(np.argmax(along))
    straight = np.zeros(3)
    straight[axis] = -(along[axis] - GAP_M) * (1.0 if low[axis] > highest[axis] else -1.0)
    for shift in (straight, moved):
        if np.any(shift):
            yield Patch(parts={joint.child: PartEdit(shift=vec(shift))})


def _apart(battery: Battery, check: Check) -> Iterator[Patch]:
    """Move a part out of what it is in, or let it collide as something smaller."""
    spec = battery.spec
    pair = next((p for p in battery.joint_checks.overlapping if check.part in p[:2]), None)
    if pair is None:
        return
    first, second, depth = pair
    moving = {joint.child for joint in spec.joints}
    child = second if second in moving else first
    other = first if child == second else second
    joint = next(j for j in spec.joints if j.child == child)
    shifts = []
    moved = np.zeros(3)
    for _ in range(8):
        here, _ = apply(Patch(parts={child: PartEdit(shift=vec(moved))}), spec)
        gap, way = separation(here, other, child)
        if gap >= 0.5 * GAP_M:
            break
        moved = moved + way * (GAP_M - gap)
    shifts.append(moved)
    size = max(depth, 1e-3) + GAP_M
    for axis in range(3):
        for sign in (1.0, -1.0):
            shift = np.zeros(3)
            shift[axis] = sign * size
            shifts.append(shift)
    # Which way leads out is known by measuring; only what does is worth the whole battery.
    good = []
    for shift in shifts:
        here, _ = apply(Patch(parts={child: PartEdit(shift=vec(shift))}), spec)
        if separation(here, other, child)[0] > -1e-3:
            good.append(shift)
    good.sort(key=lambda s: float(np.linalg.norm(s)))
    for shift in good[:4]:
        yield Patch(parts={child: PartEdit(shift=vec(shift))})
    for factor in (0.97, 0.9):
        geoms = spec.part(joint.child).geoms
        edits = {g.name: GeomEdit(shrink=factor) for g in geoms if g.role != "visual"}
        yield Patch(geoms=edits)


def separation(spec: ObjectSpec, first: str, second: str) -> tuple[float, np.ndarray]:
    """Return the signed distance of two parts at rest [m] and the unit vector between them."""
    probe = Probe(spec)
    return probe.separation(probe.names.index(first), probe.names.index(second))


def losses(spec: ObjectSpec, joint: JointSpec) -> tuple[float, float]:
    """Return the damping and dry friction that a program's joint gets by default."""
    return default_losses(joint, inertial(spec, spec.part(joint.child)))


def vec(values: np.ndarray) -> Vec3:
    """Turn three numbers of NumPy into plain ones."""
    x, y, z = (float(v) for v in values)
    return x, y, z


def _joint(battery: Battery, name: str) -> JointSpec:
    return next(joint for joint in battery.spec.joints if joint.name == name)


_CURES: dict[Fault | None, Callable[[Battery, Check], Iterator[Patch]]] = {
    Fault.INERTIA_IMPOSSIBLE: _inertia,
    Fault.MASS_IMPLAUSIBLE: _mass,
    Fault.COLLIDER_MISSING: _as_seen,
    Fault.COLLIDER_LARGE: _as_seen,
    Fault.LIMIT_INTO_PART: _cut_limits,
    Fault.LIMITS_NARROW: _widen,
    Fault.JOINT_UNDAMPED: _damp,
    Fault.LIMIT_SOFT: _damp,
    Fault.RESTLESS: _damp,
    Fault.JOINT_STUCK: _free,
    Fault.PIVOT_OFF: _pivot,
    Fault.PART_DETACHED: _together,
    Fault.PARTS_OVERLAP: _apart,
}

__all__ = ["Repaired", "losses", "proposals", "repair", "try_patches"]

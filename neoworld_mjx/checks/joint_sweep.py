"""Joint sweep: depths of overlaps between an object's parts over the ranges of its joints.

Depths are measured with all joints at zero, over the range of each joint, and with all joints moved
at once. The compile checks of Step 2 and the object tests of Step 3 compare equal measurements with
equal thresholds, so the two steps agree on which overlaps are too deep. Depths are exact
(`mj_geomDistance`), and include pairs of parent and child.

`overlap_signals` reports the overlaps to the programmer of Step 2.
"""

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import JointSweepOptions, ProgramOptions
from ..spec import JointSpec, joint_keys
from ..spec.kinematics import followers, moving_parts, welded
from ..spec.opening import prerequisite_state, with_prerequisites
from .signals import Allowance, Signal, error_signal
from .static_checks import PieceDistance, Probe

Pair = tuple[int, int]
"""Indices of two parts, in ascending order."""
State = dict[str, float]
"""Joint positions [rad or m], by the keys of `joint_keys`; a ball joint has three."""

_DIRECTIONS = [
    np.array(direction) / np.linalg.norm(direction)
    for direction in itertools.product((-1, 0, 1), repeat=3)
    if any(direction)
]
"""Unit vectors from the center of a cube to its 6 faces, 12 edges and 8 corners."""
TOUCH_GAP_M = 0.002
"""Largest gap between a part and the part to which it is attached [m]."""
SWEEP_STEPS, COMBINATIONS = 13, 16
"""Number of positions over the range of a joint, and of states in which all joints move at once."""
_RANGE_END = 0.02
"""Distance of the additional positions from the limits, as a fraction of the range."""


@dataclass(frozen=True)
class Overlap:
    """Deepest overlap of two parts, and the joint state in which it occurs."""

    depth: float
    """Depth [m]; at most 0 if the parts only touch."""
    pieces: PieceDistance
    """The two convex pieces that overlap most deeply."""
    state: State
    """Positions of the joints."""
    value: float = 0.0
    """Position of the swept joint [rad or m]."""


@dataclass(frozen=True)
class JointRange:
    """Measurements of one joint over its range, while its prerequisites are open."""

    joint: JointSpec
    prerequisites: State
    """Positions of the prerequisites."""
    moving: frozenset[int]
    """Indices of the parts that the joint moves."""
    pairs: Sequence[Pair]
    """Pairs of parts whose distance depends on the joint."""
    values: NDArray
    """Positions at which depths are measured, ascending [rad or m], shape [value]."""
    depth_ratio: NDArray
    """Largest ratio of depth to allowed depth over all pairs at each position, shape [value]."""
    deepest: Mapping[Pair, Overlap]
    """Deepest overlap of each pair that touches or overlaps."""

    @property
    def width(self) -> float:
        """Length of the range [rad or m]."""
        return float(self.values[-1] - self.values[0])


@dataclass(frozen=True)
class JointSweep:
    """Measurements of an object with all joints at zero, and over the range of each joint."""

    probe: Probe
    allowed: Mapping[Pair, float]
    """Allowed depth [m] of every pair of parts that can move relative to each other."""
    reasons: Mapping[Pair, str]
    """Reason that the program states, for each pair with an allowance above the threshold."""
    at_rest: Mapping[Pair, Overlap]
    """Overlaps with all joints at zero."""
    ranges: Sequence[JointRange]

    def too_deep(self, overlaps: Mapping[Pair, Overlap]) -> dict[Pair, Overlap]:
        """Return the overlaps that are deeper than allowed."""
        return {pair: o for pair, o in overlaps.items() if o.depth > self.allowed[pair]}

    @property
    def colliding(self) -> set[Pair]:
        """Pairs that overlap too deeply with all joints at zero, or over the range of any joint."""
        pairs = set(self.too_deep(self.at_rest))
        return pairs.union(*(self.too_deep(swept.deepest) for swept in self.ranges))


def sweep_joints(
    probe: Probe,
    options: JointSweepOptions,
    allowances: Sequence[Allowance] = (),
    *,
    ignored: Collection[str] = (),
) -> JointSweep:
    """Measure overlaps with all joints at zero, and over the range of each joint.

    A pair that overlaps too deeply with all joints at zero is not measured in motion. Parts that
    are fixed to each other may overlap, and are not measured.

    Args:
        probe: the object.
        options: the allowed depth.
        allowances: overlaps that the object's program declares.
        ignored: names of placeholder parts, which stand for links without geometry.
    """
    spec, names = probe.spec, probe.names
    group = welded(spec)
    allowed = {
        (a, b): options.max_depth_m
        for a, b in itertools.combinations(range(len(names)), 2)
        if group[names[a]] != group[names[b]] and not {names[a], names[b]} & set(ignored)
    }
    reasons: dict[Pair, str] = {}
    for allowance in allowances:
        if {allowance.first, allowance.second} <= set(names):
            a, b = sorted((names.index(allowance.first), names.index(allowance.second)))
            if allowance.depth > allowed.get((a, b), np.inf):
                allowed[a, b], reasons[a, b] = allowance.depth, allowance.reason
    probe.place({})
    at_rest = {
        pair: Overlap(-closest.distance, closest, {})
        for pair, closest in probe.depths(allowed).items()
    }
    pairs = [p for p in allowed if p not in at_rest or at_rest[p].depth <= allowed[p]]
    ranges = [
        sweep_range(probe, joint, pairs, allowed)
        for joint in spec.joints
        if joint.type != "fixed" and joint.mimic is None
    ]
    probe.place({})
    return JointSweep(probe, allowed, reasons, at_rest, ranges)


def sweep_range(
    probe: Probe,
    joint: JointSpec,
    pairs: Sequence[Pair],
    allowed: Mapping[Pair, float],
) -> JointRange:
    """Measure the deepest overlap of each pair over the range of one joint.

    The joint's prerequisites are open.

    Args:
        probe: the object.
        joint: the joint.
        pairs: pairs of parts to measure; pairs whose distance the joint cannot change are skipped.
        allowed: allowed depth [m] of each pair.
    """
    spec = probe.spec
    prerequisites = prerequisite_state(spec, joint)
    moving = frozenset(probe.names.index(name) for name in moving_parts(spec, joint))
    changed = [pair for pair in pairs if (pair[0] in moving) != (pair[1] in moving)]
    if followers(spec, joint):
        changed += [pair for pair in pairs if pair[0] in moving and pair[1] in moving]
    values = joint_positions(joint, SWEEP_STEPS)
    ratios = np.zeros(len(values))
    deepest: dict[Pair, Overlap] = {}
    for k, value in enumerate(values):
        for state, depths in _poses(probe, joint, float(value), prerequisites, changed):
            for pair, closest in depths.items():
                ratios[k] = max(ratios[k], -closest.distance / allowed[pair])
                overlap = Overlap(-closest.distance, closest, state, float(value))
                deepest[pair] = max(deepest.get(pair, overlap), overlap, key=_depth)
    return JointRange(joint, prerequisites, moving, changed, values, ratios, deepest)


def free_range(sweep: JointSweep, swept: JointRange, fraction: float = 1.0) -> tuple[float, float]:
    """Return the range around zero in which no depth exceeds a fraction of the allowed depth.

    Bisection finds the ends of the range with a tolerance of a thousandth of the joint's range.

    Args:
        sweep: measurements of the object.
        swept: measurements of the joint.
        fraction: the fraction of the allowed depth.

    Returns:
        The lower and upper end [rad or m]. The two are equal if parts collide with the joint at 0.
    """
    probe, values = sweep.probe, swept.values

    def free(value: float) -> bool:
        return not collides_at(
            probe, swept.joint, value, swept.prerequisites, swept.pairs, sweep.allowed, fraction
        )

    start = float(np.clip(0.0, values[0], values[-1]))
    if not free(start):
        return start, start
    ends = []
    for side in (np.flatnonzero(values < start)[::-1], np.flatnonzero(values > start)):
        free_end, blocked = start, None
        for k in side:
            if swept.depth_ratio[k] > fraction:
                blocked = float(values[k])
                break
            free_end = float(values[k])
        while blocked is not None and abs(blocked - free_end) > 1e-3 * swept.width:
            middle = (free_end + blocked) / 2
            free_end, blocked = (middle, blocked) if free(middle) else (free_end, middle)
        ends.append(free_end)
    return ends[0], ends[1]


def collides_at(
    probe: Probe,
    joint: JointSpec,
    value: float,
    prerequisites: State,
    pairs: Sequence[Pair],
    allowed: Mapping[Pair, float],
    fraction: float = 1.0,
) -> bool:
    """Return True if, at a joint position, any depth exceeds a fraction of the allowed depth."""
    return any(
        -closest.distance > fraction * allowed[pair]
        for _, depths in _poses(probe, joint, value, prerequisites, pairs)
        for pair, closest in depths.items()
    )


def sweep_combinations(
    sweep: JointSweep,
    free: Mapping[str, tuple[float, float]] | None = None,
) -> dict[Pair, Overlap]:
    """Move all joints at once, and return the pairs that overlap too deeply only in combinations.

    A joint moves only while its prerequisites are open. States are sampled with a fixed seed.

    Args:
        sweep: measurements of the object.
        free: range [rad or m] to which a joint is restricted, by the joint's name.
    """
    free = free or {}
    if len(sweep.ranges) < 2:
        return {}
    probe, random = sweep.probe, np.random.default_rng(0)
    colliding = sweep.colliding
    pairs = [pair for pair in sweep.allowed if pair not in colliding]
    deepest: dict[Pair, Overlap] = {}
    for k in range(COMBINATIONS):
        # In the first two states, all joints are at the upper end or all at the lower end, where
        # parts often collide.
        state: State = {}
        for swept in sweep.ranges:
            values, name = swept.values, swept.joint.name
            value = float(values[(-1, 0)[k] if k < 2 else random.integers(len(values))])
            states = joint_states(
                swept.joint, float(np.clip(value, *free.get(name, (value, value))))
            )
            state |= states[0 if len(states) == 1 else random.integers(len(states))]
        state = with_prerequisites(probe.spec, state, opening=k % 2 == 0)
        probe.place(state)
        for pair, closest in probe.depths(pairs).items():
            overlap = Overlap(-closest.distance, closest, state)
            if overlap.depth > sweep.allowed[pair]:
                deepest[pair] = max(deepest.get(pair, overlap), overlap, key=_depth)
    probe.place({})
    return deepest


def _depth(overlap: Overlap) -> float:
    return overlap.depth


def joint_positions(joint: JointSpec, steps: int) -> NDArray:
    """Return ascending positions that cover a joint's range [rad or m].

    For a ball joint, the positions are angles from the initial orientation. A limited range has two
    additional positions close to the limits, where parts often collide.
    """
    if joint.type == "continuous":
        return np.linspace(0, 2 * np.pi, steps + 3, endpoint=False)
    lower, upper = joint.lower, joint.upper
    if joint.type == "ball":
        # Each angle is measured in 26 directions, so fewer angles suffice.
        upper, steps = upper or np.pi, max(steps // 2, 3)
    end = _RANGE_END * (upper - lower)
    return np.unique(np.concatenate([np.linspace(lower, upper, steps), [lower + end, upper - end]]))


def joint_states(joint: JointSpec, value: float) -> list[State]:
    """Return the states of a joint at a value: one state, or 26 directions of a ball joint."""
    if joint.type != "ball":
        return [{joint.name: value}]
    names = joint_keys(joint)
    if value == 0.0:
        return [dict.fromkeys(names, 0.0)]
    return [
        dict(zip(names, (value * direction).tolist(), strict=True)) for direction in _DIRECTIONS
    ]


def _poses(
    probe: Probe, joint: JointSpec, value: float, prerequisites: State, pairs: Sequence[Pair]
) -> Iterator[tuple[State, dict[Pair, PieceDistance]]]:
    """Yield each state of a joint at a value, and the pairs that touch or overlap in the state."""
    for state in joint_states(joint, value):
        probe.place({**prerequisites, **state})
        yield state, probe.depths(pairs)


def overlap_signals(
    probe: Probe, options: ProgramOptions, allowances: Sequence[Allowance] = ()
) -> list[Signal]:
    """Return signals for all pairs of parts that overlap too deeply.

    Each signal states the joint state in which the pair overlaps most deeply. A joint with
    prerequisites (`after`) is moved only while the prerequisites are open, also in combinations. A
    prerequisite itself is moved while the joint is closed.
    """
    sweep = sweep_joints(probe, options, allowances)
    signals = [
        _at_rest(probe, pair, overlap, sweep.allowed[pair])
        for pair, overlap in sweep.too_deep(sweep.at_rest).items()
    ]
    for swept in sweep.ranges:
        signals += [
            _in_motion(probe, swept, pair, overlap, sweep.allowed[pair])
            for pair, overlap in sweep.too_deep(swept.deepest).items()
        ]
    for pair, overlap in sweep_combinations(sweep).items():
        a, b = (probe.names[index] for index in pair)
        state = ", ".join(f"{name} at {value:.3g}" for name, value in overlap.state.items())
        message = f"parts {a!r} and {b!r} enter each other with {state[:200]}"
        hint = "leave the parts room when several joints are open at once, or shorten a range"
        depths = {"value": overlap.depth, "threshold": sweep.allowed[pair]}
        signals.append(error_signal("overlap_in_combination", message, part=b, hint=hint, **depths))
    return signals


def rest_overlap_signals(probe: Probe, options: ProgramOptions) -> list[Signal]:
    """Return a signal for every two parts that overlap too deeply with all joints at zero.

    Parts that are fixed to each other are included.
    """
    limit = options.max_depth_m
    probe.place({})
    pairs = itertools.combinations(range(len(probe.names)), 2)
    return [
        _at_rest(probe, pair, Overlap(-closest.distance, closest, {}), limit)
        for pair, closest in probe.depths(pairs).items()
        if -closest.distance > limit
    ]


def _at_rest(probe: Probe, pair: Pair, overlap: Overlap, allowed: float) -> Signal:
    a, b = (probe.names[index] for index in pair)
    indices = (overlap.pieces.first, overlap.pieces.second)
    shapes = (probe.geom_names[probe.geom[piece]] for piece in indices)
    message = f"parts {a!r} and {b!r} enter each other at rest, at {' and '.join(shapes)}"
    hint = "parts that move against each other may touch, not overlap: leave 0.5 to 1 mm"
    depths = {"value": overlap.depth, "threshold": allowed}
    return error_signal("overlap_at_rest", message, part=b, hint=hint, **depths)


def _in_motion(
    probe: Probe, swept: JointRange, pair: Pair, overlap: Overlap, allowed: float
) -> Signal:
    joint = swept.joint
    a, b = (probe.names[index] for index in sorted(pair, key=swept.moving.__contains__))
    unit = "m" if joint.type == "prismatic" else "rad"
    position = ", ".join(f"{value:.3g}" for value in overlap.state.values())
    position = f"({position})" if joint.type == "ball" else position
    message = f"joint {joint.name!r} at {position} {unit} drives {b!r} into {a!r}"
    if joint.after:
        message += f", with {' and '.join(joint.after)} open"
    return error_signal(
        "overlap_in_motion",
        message,
        joint=joint.name,
        part=b,
        value=overlap.depth,
        threshold=allowed,
        hint="check the sign of the axis (positive opens), the anchor, the range and the "
        "clearance; what moves only when a door is open says after=; what slides or turns inside "
        "the other part (a button, a pin) needs a hole there, or allow_overlap(part, other, depth, "
        "reason)",
    )

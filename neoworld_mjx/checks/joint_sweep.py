"""Joint sweep: depth of overlap of an object's parts over the ranges of its joints.

Parts are measured at rest, over the range of each joint, and with all joints moved at once. Step
2's compile checks and Step 3's object tests compare the same measurements with the same thresholds,
so an object that passes one passes the other. Depths are exact (`mj_geomDistance`), also between
parent and child.
"""

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import JointSweepOptions
from ..spec import JointSpec, joint_keys
from ..spec.kinematics import followers, moving_parts, welded
from ..spec.opening import prerequisite_state, with_prerequisites
from .allowance import Allowance
from .part_distances import Near, Probe

Pair = tuple[int, int]
"""Indices of two parts, the lower first."""
State = dict[str, float]
"""Joint values [rad or m] by name; a ball has three."""

_DIRECTIONS = [
    np.array(direction) / np.linalg.norm(direction)
    for direction in itertools.product((-1, 0, 1), repeat=3)
    if any(direction)
]
"""Unit vectors along the axes, the edges and the diagonals of a cube."""
_RANGE_END = 0.02
"""Distance from either limit of an additional position, over the range."""


@dataclass(frozen=True)
class Overlap:
    """Two parts that touch or overlap, in the joint state in which they are deepest."""

    depth: float
    """[m], at most 0 if they only touch."""
    near: Near
    """The two convex pieces."""
    state: State
    value: float = 0.0
    """Position of the swept joint [rad or m]."""


@dataclass(frozen=True)
class JointRange:
    """Measurements of one joint over its range, while its prerequisites are open."""

    joint: JointSpec
    opened: State
    moving: frozenset[int]
    """Indices of the parts that move with it."""
    pairs: Sequence[Pair]
    """Pairs whose distance depends on the joint."""
    values: NDArray
    """Ascending positions [value], rad or m."""
    depth_share: NDArray
    """Largest ratio of depth to allowed depth over all pairs, at each position [value]."""
    deepest: Mapping[Pair, Overlap]

    @property
    def width(self) -> float:
        """Length of the range [rad or m]."""
        return float(self.values[-1] - self.values[0])


@dataclass(frozen=True)
class JointSweep:
    """Measurements of an object at rest and over the range of each joint."""

    probe: Probe
    allowed: Mapping[Pair, float]
    """Allowed depth [m] of every pair of parts that can move relative to each other."""
    reasons: Mapping[Pair, str]
    """The program's reason for allowing a pair a larger depth than the threshold."""
    at_rest: Mapping[Pair, Overlap]
    ranges: Sequence[JointRange]

    def too_deep(self, overlaps: Mapping[Pair, Overlap]) -> dict[Pair, Overlap]:
        """Select the overlaps that are deeper than allowed."""
        return {pair: o for pair, o in overlaps.items() if o.depth > self.allowed[pair]}

    @property
    def colliding(self) -> set[Pair]:
        """Pairs that are too deep at rest or over the range of some joint."""
        pairs = set(self.too_deep(self.at_rest))
        return pairs.union(*(self.too_deep(swept.deepest) for swept in self.ranges))


def sweep_joints(
    probe: Probe,
    options: JointSweepOptions,
    allowances: Sequence[Allowance] = (),
    *,
    ignored: Collection[str] = (),
) -> JointSweep:
    """Measure overlaps at rest and over the range of each joint.

    A pair that is too deep at rest is not measured in motion. Parts that are fixed to each other
    may overlap.

    Args:
        probe: the object.
        options: thresholds and the number of positions.
        allowances: overlaps that the object's program declares.
        ignored: names of placeholder parts of links without geometry.
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
        pair: Overlap(-near.distance, near, {}) for pair, near in probe.depths(allowed).items()
    }
    pairs = [p for p in allowed if p not in at_rest or at_rest[p].depth <= allowed[p]]
    ranges = [
        sweep_range(probe, joint, pairs, allowed, options.sweep_steps)
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
    steps: int,
    opened: State | None = None,
) -> JointRange:
    """Measure the deepest overlap of each pair over the range of one joint.

    Args:
        probe: the object.
        joint: the joint.
        pairs: pairs of parts to measure; pairs that the joint cannot change are skipped.
        allowed: allowed depth [m] of each pair.
        steps: number of positions.
        opened: state of the other joints; by default its prerequisites are open.
    """
    spec = probe.spec
    opened = prerequisite_state(spec, joint) if opened is None else opened
    moving = frozenset(probe.names.index(name) for name in moving_parts(spec, joint))
    changed = [pair for pair in pairs if (pair[0] in moving) != (pair[1] in moving)]
    if followers(spec, joint):
        changed += [pair for pair in pairs if pair[0] in moving and pair[1] in moving]
    values = joint_positions(joint, steps)
    share = np.zeros(len(values))
    deepest: dict[Pair, Overlap] = {}
    for k, value in enumerate(values):
        for state, depths in _poses(probe, joint, float(value), opened, changed):
            for pair, near in depths.items():
                share[k] = max(share[k], -near.distance / allowed[pair])
                overlap = Overlap(-near.distance, near, state, float(value))
                deepest[pair] = max(deepest.get(pair, overlap), overlap, key=_depth)
    return JointRange(joint, opened, moving, changed, values, share, deepest)


def free_range(sweep: JointSweep, swept: JointRange, share: float = 1.0) -> tuple[float, float]:
    """Return the range around rest in which no depth exceeds a share of the allowed depth.

    Bisection finds its ends [rad or m] to a thousandth of the joint's range.
    """
    probe, values = sweep.probe, swept.values

    def free(value: float) -> bool:
        return not collides_at(
            probe, swept.joint, value, swept.opened, swept.pairs, sweep.allowed, share
        )

    start = float(np.clip(0.0, values[0], values[-1]))
    if not free(start):
        return start, start
    ends = []
    for side in (np.flatnonzero(values < start)[::-1], np.flatnonzero(values > start)):
        inside, outside = start, None
        for k in side:
            if swept.depth_share[k] > share:
                outside = float(values[k])
                break
            inside = float(values[k])
        while outside is not None and abs(outside - inside) > 1e-3 * swept.width:
            middle = (inside + outside) / 2
            inside, outside = (middle, outside) if free(middle) else (inside, middle)
        ends.append(inside)
    return ends[0], ends[1]


def collides_at(
    probe: Probe,
    joint: JointSpec,
    value: float,
    opened: State,
    pairs: Sequence[Pair],
    allowed: Mapping[Pair, float],
    share: float = 1.0,
) -> bool:
    """Return True if any depth exceeds a share of the allowed depth at a joint position."""
    return any(
        -near.distance > share * allowed[pair]
        for _, depths in _poses(probe, joint, value, opened, pairs)
        for pair, near in depths.items()
    )


def sweep_together(
    sweep: JointSweep,
    options: JointSweepOptions,
    free: Mapping[str, tuple[float, float]] | None = None,
) -> dict[Pair, Overlap]:
    """Move all joints at once, and return the pairs that are too deep only then.

    No joint moves unless its prerequisites are open. The seed of the sampled states is fixed.

    Args:
        sweep: the object at rest and over each range.
        options: the number of sampled states.
        free: range [rad or m] to which a joint is restricted, by its name.
    """
    free = free or {}
    if len(sweep.ranges) < 2:
        return {}
    probe, random = sweep.probe, np.random.default_rng(0)
    colliding = sweep.colliding
    pairs = [pair for pair in sweep.allowed if pair not in colliding]
    deepest: dict[Pair, Overlap] = {}
    for k in range(options.sweep_combinations):
        # The first two states, all open and all closed, are those in which parts often collide.
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
        for pair, near in probe.depths(pairs).items():
            overlap = Overlap(-near.distance, near, state)
            if overlap.depth > sweep.allowed[pair]:
                deepest[pair] = max(deepest.get(pair, overlap), overlap, key=_depth)
    probe.place({})
    return deepest


def _depth(overlap: Overlap) -> float:
    return overlap.depth


def joint_positions(joint: JointSpec, steps: int) -> NDArray:
    """Return ascending values that cover a joint's range [rad or m], for a ball angles from rest.

    A limited range has two more positions close to its limits, where parts often collide.
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
    """Return the states of a joint at a value: one, or 26 for a ball, one in each direction."""
    if joint.type != "ball":
        return [{joint.name: value}]
    names = joint_keys(joint)
    if value == 0.0:
        return [dict.fromkeys(names, 0.0)]
    return [
        dict(zip(names, (value * direction).tolist(), strict=True)) for direction in _DIRECTIONS
    ]


def _poses(
    probe: Probe, joint: JointSpec, value: float, opened: State, pairs: Sequence[Pair]
) -> Iterator[tuple[State, dict[Pair, Near]]]:
    """Yield each state of a joint at a value, with the pairs that touch or overlap in it."""
    for state in joint_states(joint, value):
        probe.place({**opened, **state})
        yield state, probe.depths(pairs)

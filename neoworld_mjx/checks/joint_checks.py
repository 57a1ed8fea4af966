"""Kinematic checks of an object: overlaps over joint ranges, gaps, pivots and declared intents.

Gaps are measured with all joints at zero, because a drawer that is pulled out of its carcass is
still attached.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..config import VerifyOptions
from ..spec import JointSpec, ObjectSpec, bounds, part_bounds
from ..spec.kinematics import with_joint
from ..spec.opening import opening_alignment
from .compile_checks import MIN_OPENING_COSINE
from .joint_sweep import (
    TOUCH_GAP_M,
    JointRange,
    JointSweep,
    collides_at,
    free_range,
    sweep_combinations,
    sweep_joints,
)
from .scenarios import SINGLE_DOF_TYPES
from .signals import Allowance
from .static_checks import Probe, is_placeholder, line_box_distance
from .verdict import Check, Fault, Limit, make_check, skipped

BLOCKED_FRACTION = 0.25
"""A joint is blocked from the start if less than this fraction of its range is collision-free."""
CLEARANCE_FRACTION = 0.5
"""Depth up to which a joint position counts as free of collisions, over the allowed depth.

The full allowed depth applies if less than `BLOCKED_FRACTION` of the joint's range would remain
free.
"""
PIVOT_FRACTION = 0.05
"""Largest distance of a hinge axis from its parts, over the child's diagonal."""
GAP_SLACK, GAP_FRACTION = 2.0, 0.01
"""Limits on the gap between a part and its parent; the larger limit applies.

The first limit is a multiple of `TOUCH_GAP_M`, the second is a fraction of the object's size.
"""


@dataclass(frozen=True)
class JointChecks:
    """Results of the kinematic checks, and measurements that repairs need."""

    checks: list[Check] = field(default_factory=list)
    free: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Collision-free range around zero [rad or m] of each joint that collides within its range."""
    overlapping: list[tuple[str, str, float]] = field(default_factory=list)
    """Pairs of parts that overlap too deeply with all joints at zero, with the depth [m]."""


SWEEP_S = 30.0
"""Limit of the processor time of the checks of an object's joints [s]; 79 joints take 7 s."""


def check_joints(
    spec: ObjectSpec, options: VerifyOptions, allowances: Sequence[Allowance] = ()
) -> JointChecks:
    """Check overlaps, gaps, pivots and declared intents of an object.

    Overlaps are measured with all joints at zero, over the range of each joint, and in combinations
    of joint positions.

    Args:
        spec: the object.
        options: thresholds and the resolution of the sweep.
        allowances: overlaps that the object's program declares.

    Raises:
        OutOfTime: the checks take over `SWEEP_S` of processor time.
    """
    probe = Probe(spec, SWEEP_S)
    placeholders = [part.name for part in spec.parts if is_placeholder(part)]
    sweep = sweep_joints(probe, options, allowances, ignored=placeholders)
    free = {
        swept.joint.name: _free_range(sweep, swept)
        for swept in sweep.ranges
        if sweep.too_deep(swept.deepest)
    }
    overlapping = [
        (probe.names[a], probe.names[b], overlap.depth)
        for (a, b), overlap in sweep.too_deep(sweep.at_rest).items()
    ]
    checks = list(_at_rest(sweep, options))
    checks += [_over_range(sweep, swept, free, options) for swept in sweep.ranges]
    if len(sweep.ranges) > 1:
        checks.append(_combinations(sweep, free, options))
    probe.place({})
    checks += _gaps(probe)
    checks += _pivots(probe)
    checks += _intents(spec)
    return JointChecks(checks, free, overlapping)


def _at_rest(sweep: JointSweep, options: VerifyOptions) -> Iterator[Check]:
    """Check the depth of pairs of parts that overlap with all joints at zero.

    Yield one check for each pair that overlaps too deeply or has a declared allowance. If no pair
    fails, also yield one check of the deepest other overlap.
    """
    worst, worst_evidence, failed = 0.0, "", False
    depths = dict.fromkeys(sweep.reasons, 0.0) | {p: o.depth for p, o in sweep.at_rest.items()}
    for pair, depth in depths.items():
        first, second = (sweep.probe.names[k] for k in pair)
        limit = Limit(sweep.allowed[pair], "m", Fault.PARTS_OVERLAP)
        name, evidence = f"part_depth:{first}:{second}", f"{first} and {second}"
        check = make_check("static", name, depth, limit, part=second, evidence=evidence)
        if check.failed:
            failed = True
            yield check
        elif pair in sweep.reasons:
            # The program declares the allowed depth, so a depth close to it is not borderline.
            evidence += f", granted: {sweep.reasons[pair]}"
            yield check.model_copy(update={"borderline": False, "evidence": evidence})
        elif depth > worst:
            worst, worst_evidence = depth, evidence
    if not failed:
        limit = Limit(options.max_depth_m, "m", Fault.PARTS_OVERLAP)
        yield make_check("static", "part_depth", worst, limit, evidence=worst_evidence)


def _over_range(
    sweep: JointSweep,
    swept: JointRange,
    free: Mapping[str, tuple[float, float]],
    options: VerifyOptions,
) -> Check:
    """Check the largest depth over one joint's range.

    The fault of a collision is the pivot, the axis (the joint is blocked from the start), or a
    limit.
    """
    probe, joint, default_depth = sweep.probe, swept.joint, options.max_depth_m
    # Ignore pairs whose depth is within a declared allowance.
    considered = {
        pair: overlap
        for pair, overlap in swept.deepest.items()
        if overlap.depth > sweep.allowed[pair] or sweep.allowed[pair] <= default_depth
    }
    pair = max(considered, key=lambda pair: considered[pair].depth, default=None)
    depth, value, threshold, other, state = 0.0, 0.0, default_depth, "", {}
    if pair is not None:
        overlap, threshold = considered[pair], sweep.allowed[pair]
        depth, value, state = max(overlap.depth, 0.0), overlap.value, overlap.state
        other = probe.names[next((k for k in pair if k not in swept.moving), pair[0])]
    fault = Fault.LIMIT_INTO_PART
    if joint.name in free:
        low, high = free[joint.name]
        if joint.type == "revolute" and _better_pivot(sweep, swept):
            fault = Fault.PIVOT_OFF
        elif high - low < BLOCKED_FRACTION * swept.width:
            fault = Fault.JOINT_INTO_PART
    unit = "m" if joint.type == "prismatic" else "rad"
    position = f"{value:.3g}"
    if joint.type == "ball":
        position = f"({', '.join(f'{v:.3g}' for v in state.values())})"
    evidence = f"{joint.child} in {other} with {joint.name} at {position} {unit}"
    evidence += "".join(f", {name} open" for name in swept.prerequisites)
    names = {"part": joint.child, "joint": joint.name}
    limit = Limit(threshold, "m", fault)
    return make_check(
        "joint_range", f"depth:{joint.name}", depth, limit, **names, at=value, evidence=evidence
    )


def _free_range(sweep: JointSweep, swept: JointRange) -> tuple[float, float]:
    """Return a joint's collision-free range around zero [rad or m], with clearance if possible."""
    # A range that is cut exactly at the threshold would pass only as borderline.
    low, high = free_range(sweep, swept, CLEARANCE_FRACTION)
    if high - low >= BLOCKED_FRACTION * swept.width:
        return low, high
    return free_range(sweep, swept)


def _better_pivot(sweep: JointSweep, swept: JointRange) -> bool:
    """Return True if moving a hinge to an edge of its child would remove all collisions.

    Return False if the hinge already lies on an edge of the child, because the pivot is then not
    the fault.
    """
    spec, joint = sweep.probe.spec, swept.joint
    low, high = part_bounds(spec, spec.part(joint.child))
    if on_edge(joint, low, high):
        return False
    for edge in pivot_edges(joint, low, high):
        candidate = joint.model_copy(update={"pos": tuple(edge.tolist())})
        probe = Probe(with_joint(spec, candidate))
        if not any(
            collides_at(
                probe, candidate, float(value), swept.prerequisites, swept.pairs, sweep.allowed
            )
            for value in swept.values
        ):
            return True
    return False


def on_edge(joint: JointSpec, low: NDArray, high: NDArray) -> bool:
    """Return True if a joint's axis runs along an edge of a box.

    The tolerance is 10 % of the box's diagonal perpendicular to the axis.
    """
    axis = np.array(joint.axis)
    offsets = pivot_edges(joint, low, high) - np.array(joint.pos)
    if not len(offsets):
        return False
    distances = np.linalg.norm(offsets - np.outer(offsets @ axis, axis), axis=1)
    diagonal = float(np.linalg.norm((high - low) * (np.abs(axis) < 0.99)))
    return float(distances.min()) < 0.1 * diagonal


def pivot_edges(joint: JointSpec, low: NDArray, high: NDArray) -> NDArray:
    """Return the midpoints of the four edges of a box that are parallel to a joint's axis.

    Returns:
        Points [m], shape [4, 3]. If the axis is oblique, the shape is [0, 3].
    """
    along = int(np.argmax(np.abs(joint.axis)))
    if abs(joint.axis[along]) < 0.99:
        return np.zeros((0, 3))
    u, v = (k for k in range(3) if k != along)
    edges = np.tile((low + high) / 2, (4, 1))
    edges[:, u] = [low[u], low[u], high[u], high[u]]
    edges[:, v] = [low[v], high[v], low[v], high[v]]
    return edges


def _combinations(
    sweep: JointSweep, free: Mapping[str, tuple[float, float]], options: VerifyOptions
) -> Check:
    """Check the largest depth while all joints move at once within their collision-free ranges."""
    deepest = sweep_combinations(sweep, free)
    pair = max(deepest, key=lambda pair: deepest[pair].depth, default=None)
    worst, evidence, threshold = 0.0, "", options.max_depth_m
    if pair is not None:
        overlap, (first, second) = deepest[pair], (sweep.probe.names[k] for k in pair)
        state = ", ".join(f"{name} at {value:.3g}" for name, value in overlap.state.items())
        worst, threshold = overlap.depth, sweep.allowed[pair]
        evidence = f"{first} in {second} with {state}"[:300]
    limit = Limit(threshold, "m", Fault.RANGE_CONFLICT)
    return make_check("joint_range", "depth:together", worst, limit, evidence=evidence)


def _gaps(probe: Probe) -> Iterator[Check]:
    """Yield a check of the gap between each part and its parent, in the probe's present state."""
    low, high = bounds(probe.spec)
    size = float(np.linalg.norm(high - low))
    slack = max(GAP_SLACK * TOUCH_GAP_M, GAP_FRACTION * size)
    reach = 20 * slack
    limit = Limit(slack, "m", Fault.PART_DETACHED)
    for joint in probe.spec.joints:
        ends = joint.parent, joint.child
        if any(is_placeholder(probe.spec.part(name)) for name in ends):
            continue
        parent, child = (probe.of_part(probe.names.index(name)) for name in ends)
        closest = probe.nearest(parent, child, reach)
        gap = reach if closest is None else max(closest.distance, 0.0)
        yield make_check(
            "static", f"gap:{joint.name}", gap, limit, part=joint.child, joint=joint.name,
            evidence=f"{joint.child} hangs in the air beside {joint.parent}",
        )  # fmt: skip


def _pivots(probe: Probe) -> Iterator[Check]:
    """Check the distance [m] of each turning joint's axis from the two parts that it connects."""
    for joint in probe.spec.joints:
        placeholders = [is_placeholder(probe.spec.part(n)) for n in (joint.child, joint.parent)]
        if joint.type not in ("revolute", "continuous") or placeholders[0]:
            continue
        child, parent = (
            probe.extent(probe.names.index(name)) for name in (joint.child, joint.parent)
        )
        point, axis = np.array(joint.pos), np.array(joint.axis)
        distance = line_box_distance(point, axis, *child)
        if not placeholders[1]:
            # Half of the distance from the parent counts, because the hinge has a size, so the
            # parent may end before the axis.
            distance = max(distance, line_box_distance(point, axis, *parent) / 2)
        size = float(np.linalg.norm(child[1] - child[0]))
        limit = Limit(max(PIVOT_FRACTION * size, 0.004), "m", Fault.PIVOT_OFF)
        yield make_check(
            "static", f"pivot:{joint.name}", distance, limit, part=joint.child, joint=joint.name,
            evidence=f"the axis of {joint.name} passes beside {joint.child} or {joint.parent}",
        )  # fmt: skip


def _intents(spec: ObjectSpec) -> Iterator[Check]:
    """Yield checks of each joint's type, direction and travel against the declared intent."""
    for joint in spec.joints:
        intent, names = joint.intent, {"part": joint.child, "joint": joint.name}
        if intent is None:
            if joint.type in SINGLE_DOF_TYPES:
                yield skipped("intent", joint.name, "no intent is declared", joint.name)
            continue
        if intent.type is not None:
            wrong = 0.0 if intent.type == joint.type else 1.0
            limit = Limit(0.0, "", Fault.JOINT_TYPE)
            evidence = f"{joint.name} is {joint.type} and meant to be {intent.type}"
            name = f"type:{joint.name}"
            yield make_check("intent", name, wrong, limit, **names, evidence=evidence)
            if wrong:
                continue
        if intent.opens is not None and joint.type in SINGLE_DOF_TYPES:
            name, cosine = f"opens:{joint.name}", opening_alignment(spec, joint)
            if cosine is None:
                reason = "its middle hardly moves, so it has no opening direction"
                yield skipped("intent", name, reason, joint.name)
                continue
            limit = Limit(MIN_OPENING_COSINE, "cosine", Fault.AXIS_REVERSED, least=True)
            evidence = f"{joint.child} sets out the wrong way"
            yield make_check("intent", name, cosine, limit, **names, evidence=evidence)
        if intent.travel is not None and joint.type in ("revolute", "prismatic"):
            unit, travel = "m" if joint.type == "prismatic" else "rad", intent.travel
            limit = Limit(0.9 * travel, unit, Fault.LIMITS_NARROW, least=True, best=travel)
            width = joint.upper - joint.lower
            yield make_check("intent", f"travel:{joint.name}", width, limit, **names)

"""Kinematic checks of an object: overlaps over every range, gaps, pivots, declared intents.

Gaps are measured at rest: a drawer that is pulled out of its carcass is still attached.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..config import VerifyOptions
from ..spec import JointSpec, ObjectSpec, bounds, part_bounds
from ..spec.kinematics import with_joint
from ..spec.opening import opening_alignment
from .allowance import Allowance
from .compile_checks import OPENS_COSINE
from .joint_sweep import (
    JointRange,
    JointSweep,
    collides_at,
    free_range,
    sweep_joints,
    sweep_together,
)
from .part_distances import Probe, line_box_distance
from .scenarios import SINGLE
from .static_checks import is_placeholder
from .verdict import Check, Fault, Limit, judged, skipped

AT_ONCE = 0.25
"""Share of its range below which a joint's free range counts as blocked from the start."""
CLEAR = 0.5
"""Share of the allowed depth up to which a range counts as free, if any of it then does."""
GAP_SLACK, GAP_SHARE = 2.0, 0.01
"""Widest gap between a part and its parent, over `touch_gap_m`, and over the object's size."""


@dataclass
class JointChecks:
    """Checks of the joint sweep, and what repairs need of its measurements."""

    checks: list[Check] = field(default_factory=list)
    free: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Free range around rest [rad or m] of each joint that collides within its range."""
    overlapping: list[tuple[str, str, float]] = field(default_factory=list)
    """Pairs of parts that overlap at rest, with the depth [m]."""


def check_joints(
    spec: ObjectSpec, options: VerifyOptions, allowances: Sequence[Allowance] = ()
) -> JointChecks:
    """Check overlaps at rest, over ranges and in combinations, then gaps, pivots and intents.

    Args:
        spec: the object.
        options: thresholds and how finely ranges are swept.
        allowances: overlaps that its program declares.
    """
    probe = Probe(spec)
    helpers = [part.name for part in spec.parts if is_placeholder(part)]
    sweep = sweep_joints(probe, options, allowances, ignored=helpers)
    result = JointChecks()
    _at_rest(sweep, result, options)
    for swept in sweep.ranges:
        _over_range(sweep, swept, result, options)
    if len(sweep.ranges) > 1:
        _together(sweep, result, options)
    probe.place({})
    result.checks += _gaps(probe, options)
    for joint in spec.joints:
        if joint.type in ("revolute", "continuous") and joint.child not in helpers:
            result.checks.append(_pivot(probe, joint, options))
    result.checks += intents(spec)
    return result


def _at_rest(sweep: JointSweep, result: JointChecks, options: VerifyOptions) -> None:
    """Check the depth of every pair of parts that overlaps at rest."""
    worst, between = 0.0, ""
    depths = dict.fromkeys(sweep.reasons, 0.0) | {p: o.depth for p, o in sweep.at_rest.items()}
    for pair, depth in depths.items():
        first, second = (sweep.probe.names[k] for k in pair)
        limit = Limit(threshold=sweep.allowed[pair], unit="m", fault=Fault.PARTS_OVERLAP)
        name, evidence = f"part_depth:{first}:{second}", f"{first} and {second}"
        if depth > sweep.allowed[pair]:
            result.overlapping.append((first, second, depth))
            result.checks.append(
                judged("static", name, depth, limit, part=second, evidence=evidence)
            )
        elif pair in sweep.reasons:
            check = judged("static", name, depth, limit, part=second)
            # The program declares this depth, so a depth close to it is not doubtful.
            update = {
                "borderline": False,
                "evidence": f"{evidence}, granted: {sweep.reasons[pair]}",
            }
            result.checks.append(check.model_copy(update=update))
        elif depth > worst:
            worst, between = depth, evidence
    if not result.overlapping:
        limit = Limit(threshold=options.max_depth_m, unit="m", fault=Fault.PARTS_OVERLAP)
        result.checks.append(judged("static", "part_depth", worst, limit, evidence=between))


def _over_range(
    sweep: JointSweep, swept: JointRange, result: JointChecks, options: VerifyOptions
) -> None:
    """Check the depth over one joint's range; where it fails, measure the range that is free."""
    probe, joint, usual = sweep.probe, swept.joint, options.max_depth_m
    # A pair that is allowed more, and is no deeper than that, does not count against the joint.
    counted = {
        pair: overlap
        for pair, overlap in swept.deepest.items()
        if overlap.depth > sweep.allowed[pair] or sweep.allowed[pair] <= usual
    }
    pair = max(counted, key=lambda pair: counted[pair].depth, default=None)
    overlap = None if pair is None else counted[pair]
    other = ""
    if pair is not None:
        other = probe.names[next((k for k in pair if k not in swept.moving), pair[0])]
    fault = Fault.LIMIT_INTO_PART
    if sweep.too_deep(swept.deepest):
        # A range that is cut right at the threshold would pass only as doubtful.
        for share in (CLEAR, 1.0):
            free = free_range(sweep, swept, share)
            if free[1] - free[0] >= AT_ONCE * swept.width:
                break
        else:
            fault = Fault.JOINT_INTO_PART
        result.free[joint.name] = free
        if joint.type == "revolute" and _better_pivot(sweep, swept):
            fault = Fault.PIVOT_OFF
    depth, value = (0.0, 0.0) if overlap is None else (max(overlap.depth, 0.0), overlap.value)
    limit = Limit(threshold=usual if pair is None else sweep.allowed[pair], unit="m", fault=fault)
    unit = "m" if joint.type == "prismatic" else "rad"
    position = f"{value:.3g}"
    if joint.type == "ball":
        state = {} if overlap is None else overlap.state
        position = f"({', '.join(f'{v:.3g}' for v in state.values())})"
    evidence = f"{joint.child} in {other} with {joint.name} at {position} {unit}"
    result.checks.append(
        judged(
            "joint_range", f"depth:{joint.name}", depth, limit, part=joint.child, joint=joint.name,
            at=value, evidence=evidence + "".join(f", {name} open" for name in swept.opened),
        )
    )  # fmt: skip


def _better_pivot(sweep: JointSweep, swept: JointRange) -> bool:
    """Tell whether a hinge that is on no edge of its child would be free of collisions on one.

    A hinge belongs on an edge of the part that it turns. If it is elsewhere and an edge would free
    its range, its pivot is the fault; a hinge that is on an edge has another fault.
    """
    spec, joint = sweep.probe.spec, swept.joint
    low, high = part_bounds(spec, spec.part(joint.child))
    if on_edge(joint, low, high):
        return False
    for edge in pivot_edges(joint, low, high):
        moved = joint.model_copy(update={"pos": tuple(edge.tolist())})
        probe = Probe(with_joint(spec, moved))
        if not any(
            collides_at(probe, moved, float(value), swept.opened, swept.pairs, sweep.allowed)
            for value in swept.values
        ):
            return True
    return False


def on_edge(joint: JointSpec, low: NDArray, high: NDArray) -> bool:
    """Tell whether a joint's axis runs along an edge of a box, within a tenth of its diagonal."""
    axis = np.array(joint.axis)
    off = pivot_edges(joint, low, high) - np.array(joint.pos)
    wide = (high - low) * (np.abs(axis) < 0.99)
    if not len(off):
        return False
    return float(np.linalg.norm(off - np.outer(off @ axis, axis), axis=1).min()) < 0.1 * float(
        np.linalg.norm(wide)
    )


def pivot_edges(joint: JointSpec, low: NDArray, high: NDArray) -> NDArray:
    """Return points [4, 3] m on a box's four edges along a joint's axis; none if it is oblique."""
    along = int(np.argmax(np.abs(joint.axis)))
    if abs(joint.axis[along]) < 0.99:
        return np.zeros((0, 3))
    u, v = (k for k in range(3) if k != along)
    edges = np.tile((low + high) / 2, (4, 1))
    edges[:, u] = [low[u], low[u], high[u], high[u]]
    edges[:, v] = [low[v], high[v], low[v], high[v]]
    return edges


def _together(sweep: JointSweep, result: JointChecks, options: VerifyOptions) -> None:
    """Check the depth while all joints move at once, within their free ranges."""
    deepest = sweep_together(sweep, options, result.free)
    pair = max(deepest, key=lambda pair: deepest[pair].depth, default=None)
    worst, evidence, threshold = 0.0, "", options.max_depth_m
    if pair is not None:
        overlap, (first, second) = deepest[pair], (sweep.probe.names[k] for k in pair)
        state = ", ".join(f"{name} at {value:.3g}" for name, value in overlap.state.items())
        worst, threshold = overlap.depth, sweep.allowed[pair]
        evidence = f"{first} in {second} with {state}"[:300]
    limit = Limit(threshold=threshold, unit="m", fault=Fault.RANGE_CONFLICT)
    result.checks.append(judged("joint_range", "depth:together", worst, limit, evidence=evidence))


def _gaps(probe: Probe, options: VerifyOptions) -> Iterator[Check]:
    """Yield a check of the gap [m] at rest between each part and its parent."""
    low, high = bounds(probe.spec)
    size = float(np.linalg.norm(high - low))
    slack = max(GAP_SLACK * options.touch_gap_m, GAP_SHARE * size)
    reach = 20 * slack
    limit = Limit(threshold=slack, unit="m", fault=Fault.PART_DETACHED)
    for joint in probe.spec.joints:
        if is_placeholder(probe.spec.part(joint.child)) or is_placeholder(
            probe.spec.part(joint.parent)
        ):
            continue
        parent_pieces, child_pieces = (
            probe.of_part(probe.names.index(name)) for name in (joint.parent, joint.child)
        )
        near = probe.nearest(parent_pieces, child_pieces, reach)
        gap = reach if near is None else max(near.distance, 0.0)
        evidence = f"{joint.child} hangs in the air beside {joint.parent}"
        yield judged(
            "static", f"gap:{joint.name}", gap, limit, part=joint.child, joint=joint.name,
            evidence=evidence,
        )  # fmt: skip


def _pivot(probe: Probe, joint: JointSpec, options: VerifyOptions) -> Check:
    """Check the distance [m] of a turning joint's axis from the two parts that it joins."""
    low, high = probe.extent(probe.names.index(joint.child))
    size = float(np.linalg.norm(high - low))
    point, axis = np.array(joint.pos), np.array(joint.axis)
    off = line_box_distance(point, axis, low, high)
    if not is_placeholder(probe.spec.part(joint.parent)):
        # A hinge has a size of its own, so the parent may end short of the axis: half counts.
        off = max(
            off, line_box_distance(point, axis, *probe.extent(probe.names.index(joint.parent))) / 2
        )
    limit = Limit(
        threshold=max(options.max_pivot_off * size, 0.004), unit="m", fault=Fault.PIVOT_OFF
    )
    return judged(
        "static", f"pivot:{joint.name}", off, limit, part=joint.child, joint=joint.name,
        evidence=f"the axis of {joint.name} passes beside {joint.child} or {joint.parent}",
    )  # fmt: skip


def intents(spec: ObjectSpec) -> Iterator[Check]:
    """Yield checks of each joint's type, direction and travel against its declared intent."""
    for joint in spec.joints:
        intent = joint.intent
        if intent is None:
            if joint.type in SINGLE:
                yield skipped("intent", joint.name, "no intent is declared", joint.name)
            continue
        if intent.type is not None:
            wrong = 0.0 if intent.type == joint.type else 1.0
            limit = Limit(threshold=0.0, unit="", fault=Fault.JOINT_TYPE)
            evidence = f"{joint.name} is {joint.type} and meant to be {intent.type}"
            yield judged(
                "intent", f"type:{joint.name}", wrong, limit, part=joint.child, joint=joint.name,
                evidence=evidence,
            )  # fmt: skip
            if wrong:
                continue
        if intent.opens is not None and joint.type in SINGLE:
            limit = Limit(
                threshold=OPENS_COSINE, unit="cosine", fault=Fault.AXIS_REVERSED, least=True
            )
            cosine = opening_alignment(spec, joint)
            if cosine is None:
                reason = "its middle hardly moves, so it opens no way"
                yield skipped("intent", f"opens:{joint.name}", reason, joint.name)
                continue
            yield judged(
                "intent", f"opens:{joint.name}", cosine, limit, part=joint.child,
                joint=joint.name, evidence=f"{joint.child} sets out the wrong way",
            )  # fmt: skip
        if intent.travel is not None and joint.type in ("revolute", "prismatic"):
            limit = Limit(
                threshold=0.9 * intent.travel,
                unit="m" if joint.type == "prismatic" else "rad",
                fault=Fault.LIMITS_NARROW,
                least=True,
                best=intent.travel,
            )
            width = joint.upper - joint.lower
            yield judged(
                "intent", f"travel:{joint.name}", width, limit, part=joint.child, joint=joint.name
            )

"""What can be said of an object by posing it: overlaps over every range, gaps, pivots, intents.

Depths are exact (`mj_geomDistance`), parent and child included. What a joint does is no separation:
parts are held to belong together where the object is drawn, at rest.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..config import VerifyOptions
from ..physics.mjcf import welded
from ..program.allowance import Allowance
from ..program.probe import Probe
from ..spec import JointSpec, ObjectSpec, bounds, part_bounds
from ..spec.opening import opening_alignment, prerequisite_state, with_prerequisites
from .scenarios import SINGLE
from .static_checks import helper
from .verdict import Check, Fault, Limit, judged, skipped

Pair = tuple[int, int]
_WAYS = [
    tuple((np.array(way) / np.linalg.norm(way)).tolist())
    for way in itertools.product((-1, 0, 1), repeat=3)
    if any(way)
]
"""Along the axes, the edges and the diagonals of a cube."""
AT_ONCE = 0.25
"""A joint that is free over less than this share of its range runs into something at once."""

CLEAR = 0.5
"""Share of the depth let pass up to which a range counts as free, where that leaves any."""


@dataclass
class JointSweepChecks:
    """What the sweep found, for checks and for repairs."""

    checks: list[Check] = field(default_factory=list)
    free: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Of each joint that runs into something: the part of its range around rest that is free."""
    overlapping: list[tuple[str, str, float]] = field(default_factory=list)
    """Parts that enter each other at rest, and how deep [m]."""


def ranges(
    spec: ObjectSpec, options: VerifyOptions, allowed: Sequence[Allowance] = ()
) -> JointSweepChecks:
    """Measure overlaps at rest, over each joint's range and in combinations, then gaps and pivots.

    Args:
        spec: the object.
        options: thresholds and how finely ranges are swept.
        allowed: overlaps that its program asks for.
    """
    probe = Probe(spec)
    found = JointSweepChecks()
    rigid = welded(spec)
    names = probe.names
    is_helper = lambda name: helper(spec.part(name))
    limits = {
        (a, b): options.max_depth_m
        for a, b in itertools.combinations(range(len(names)), 2)
        if rigid[names[a]] != rigid[names[b]] and not (is_helper(names[a]) or is_helper(names[b]))
    }
    granted: dict[Pair, str] = {}
    for one in allowed:
        if {one.first, one.second} <= set(names):
            a, b = sorted((names.index(one.first), names.index(one.second)))
            if one.depth > limits.get((a, b), np.inf):
                limits[a, b], granted[a, b] = one.depth, one.reason
    bad = _at_rest(probe, limits, granted, found, options)
    driven = [j for j in spec.joints if j.type != "fixed" and j.mimic is None]
    for joint in driven:
        bad |= _over_range(probe, joint, limits, bad, found, options)
    if len(driven) > 1:
        _combined(probe, driven, limits, bad, found, options)
    probe.place({})
    found.checks += _gaps(probe, options)
    for joint in spec.joints:
        if joint.type in ("revolute", "continuous") and not is_helper(joint.child):
            found.checks.append(_pivot(probe, joint, options))
    found.checks += intents(spec)
    return found


def _at_rest(
    probe: Probe,
    limits: dict[Pair, float],
    granted: dict[Pair, str],
    found: JointSweepChecks,
    options: VerifyOptions,
) -> set[Pair]:
    bad: set[Pair] = set()
    worst, between = 0.0, ""
    depths = {pair: -near.distance for pair, near in probe.depths(limits).items()}
    for pair, depth in (dict.fromkeys(granted, 0.0) | depths).items():
        first, second = (probe.names[k] for k in pair)
        limit = Limit(threshold=limits[pair], unit="m", fault=Fault.PARTS_OVERLAP)
        told = f"{first} and {second}"
        name = f"part_depth:{first}:{second}"
        if depth > limits[pair]:
            bad.add(pair)
            found.overlapping.append((first, second, depth))
            found.checks.append(judged("static", name, depth, limit, part=second, evidence=told))
        elif pair in granted:
            check = judged("static", name, depth, limit, part=second)
            # It is asked for as deep as it is: no doubt in that.
            update = {"doubtful": False, "evidence": f"{told}, granted: {granted[pair]}"}
            found.checks.append(check.model_copy(update=update))
        elif depth > worst:
            worst, between = depth, told
    if not bad:
        limit = Limit(threshold=options.max_depth_m, unit="m", fault=Fault.PARTS_OVERLAP)
        found.checks.append(judged("static", "part_depth", worst, limit, evidence=between))
    return bad


def _over_range(
    probe: Probe,
    joint: JointSpec,
    limits: dict[Pair, float],
    bad: set[Pair],
    found: JointSweepChecks,
    options: VerifyOptions,
) -> set[Pair]:
    """Sweep one joint, with those open that it waits for; a failure says how much around rest is free."""
    moving = {probe.names.index(name) for name in carried(probe.spec, joint)}
    pairs = [p for p in limits if p not in bad and (p[0] in moving) != (p[1] in moving)]
    if any(j.mimic is not None for j in probe.spec.joints):
        pairs += [p for p in limits if p not in bad and p[0] in moving and p[1] in moving]
    values = positions(joint, options.sweep_steps)
    opened = prerequisite_state(probe.spec, joint)
    over = np.zeros(len(values))
    worst: dict[Pair, tuple[float, float, dict[str, float]]] = {}
    for k, value in enumerate(values):
        for state in states(joint, float(value)):
            probe.place({**opened, **state})
            for pair, near in probe.depths(pairs).items():
                over[k] = max(over[k], -near.distance / limits[pair])
                if -near.distance > worst.get(pair, (0.0,))[0]:
                    worst[pair] = (-near.distance, float(value), state)
    # What is granted deeper, and is no deeper than that, is not held against the joint.
    usual = options.max_depth_m
    counts = {p: v for p, v in worst.items() if v[0] > limits[p] or limits[p] <= usual}
    deepest = max(counts.items(), key=lambda item: item[1][0], default=None)
    depth, at, how = (0.0, 0.0, {}) if deepest is None else deepest[1]
    other = ""
    if deepest is not None:
        other = probe.names[next((k for k in deepest[0] if k not in moving), deepest[0][0])]
    colliding = {p for p, (d, *_) in worst.items() if d > limits[p]}
    fault = Fault.LIMIT_INTO_PART
    if colliding:
        # What is cut to a range just at the threshold would be in doubt at once.
        width = float(values[-1] - values[0])
        for share in (CLEAR, 1.0):
            free = _free(probe, joint, values, over, pairs, limits, share)
            if free[1] - free[0] >= AT_ONCE * width:
                break
        else:
            fault = Fault.JOINT_INTO_PART
        found.free[joint.name] = free
        if joint.type == "revolute" and _better_pivot(probe, joint, pairs, limits, options):
            fault = Fault.PIVOT_OFF
    limit = Limit(
        threshold=options.max_depth_m if deepest is None else limits[deepest[0]],
        unit="m",
        fault=fault,
    )
    unit = "m" if joint.type == "prismatic" else "rad"
    told = ", ".join(f"{value:.3g}" for value in how.values())
    told = f"({told})" if joint.type == "ball" else f"{at:.3g}"
    found.checks.append(
        judged(
            "joint_range",
            f"depth:{joint.name}",
            depth,
            limit,
            part=joint.child,
            joint=joint.name,
            at=at,
            evidence=f"{joint.child} in {other} with {joint.name} at {told} {unit}"
            + "".join(f", {name} open" for name in opened),
        )
    )
    return colliding


def _free(
    probe: Probe,
    joint: JointSpec,
    values: NDArray,
    over: NDArray,
    pairs: list[Pair],
    limits: dict[Pair, float],
    share: float,
) -> tuple[float, float]:
    """Return the range around rest in which nothing is deeper than a share of its limit.

    It is right to a thousandth of the whole.
    """
    opened = prerequisite_state(probe.spec, joint)

    def clear(value: float) -> bool:
        for state in states(joint, value):
            probe.place({**opened, **state})
            if any(-near.distance > share * limits[p] for p, near in probe.depths(pairs).items()):
                return False
        return True

    rest = float(np.clip(0.0, values[0], values[-1]))
    if not clear(rest):
        return rest, rest
    ends = []
    for side in (values[values < rest][::-1], values[values > rest]):
        inside, outside = rest, None
        for value in side:
            if over[int(np.argmin(np.abs(values - value)))] > share:
                outside = float(value)
                break
            inside = float(value)
        while outside is not None and abs(outside - inside) > 1e-3 * (values[-1] - values[0]):
            middle = (inside + outside) / 2
            inside, outside = (middle, outside) if clear(middle) else (inside, middle)
        ends.append(inside)
    return ends[0], ends[1]


def _better_pivot(
    probe: Probe,
    joint: JointSpec,
    pairs: list[Pair],
    limits: dict[Pair, float],
    options: VerifyOptions,
) -> bool:
    """Tell whether a pivot within the part, on none of its edges, collides where an edge would not.

    A hinge sits on an edge of what it turns. One that does not, and whose range would be free if it
    did, is in the wrong place; one that sits on an edge has another fault.
    """
    spec = probe.spec
    low, high = part_bounds(spec, spec.part(joint.child))
    edges = pivot_edges(joint, low, high)
    if not len(edges) or on_edge(joint, low, high):
        return False
    opened = prerequisite_state(spec, joint)
    for edge in edges:
        moved = joint.model_copy(update={"pos": tuple(edge.tolist())})
        other = Probe(with_joint(spec, moved))
        for value in positions(joint, options.sweep_steps):
            other.place({**opened, joint.name: float(value)})
            if any(-near.distance > limits[p] for p, near in other.depths(pairs).items()):
                break
        else:
            return True
    return False


def on_edge(joint: JointSpec, low: NDArray, high: NDArray) -> bool:
    """Tell whether a joint's axis runs along an edge of a box, to a tenth of the box's width."""
    axis = np.array(joint.axis)
    off = pivot_edges(joint, low, high) - np.array(joint.pos)
    wide = (high - low) * (np.abs(axis) < 0.99)
    if not len(off):
        return False
    return float(np.linalg.norm(off - np.outer(off @ axis, axis), axis=1).min()) < 0.1 * float(
        np.linalg.norm(wide)
    )


def pivot_edges(joint: JointSpec, low: NDArray, high: NDArray) -> NDArray:
    """Return points on the four edges of a box along a joint's axis [4, 3] m; none if it is askew."""
    along = int(np.argmax(np.abs(joint.axis)))
    if abs(joint.axis[along]) < 0.99:
        return np.zeros((0, 3))
    one, two = (k for k in range(3) if k != along)
    edges = np.tile((low + high) / 2, (4, 1))
    edges[:, one] = [low[one], low[one], high[one], high[one]]
    edges[:, two] = [low[two], high[two], low[two], high[two]]
    return edges


def _combined(
    probe: Probe,
    driven: list[JointSpec],
    limits: dict[Pair, float],
    bad: set[Pair],
    found: JointSweepChecks,
    options: VerifyOptions,
) -> None:
    random, spec = np.random.default_rng(0), probe.spec
    rest = [pair for pair in limits if pair not in bad]
    ends = [(joint, positions(joint, options.sweep_steps)) for joint in driven]
    worst, shown, limit_at = 0.0, "", options.max_depth_m
    for k in range(options.sweep_combinations):
        # All open and all closed come first: that is where what swings past each other meets.
        state: dict[str, float] = {}
        for joint, values in ends:
            value = float(values[(-1, 0)[k] if k < 2 else random.integers(len(values))])
            ways = states(joint, float(np.clip(value, *found.free.get(joint.name, (value, value)))))
            state |= ways[0 if len(ways) == 1 else random.integers(len(ways))]
        state = with_prerequisites(spec, state, opening=k % 2 == 0)
        probe.place(state)
        for pair, near in probe.depths(rest).items():
            if -near.distance > max(worst, limits[pair]):
                worst, limit_at = -near.distance, limits[pair]
                told = ", ".join(f"{name} at {value:.3g}" for name, value in state.items())
                shown = f"{probe.names[pair[0]]} in {probe.names[pair[1]]} with {told}"[:300]
    limit = Limit(threshold=limit_at, unit="m", fault=Fault.RANGE_CONFLICT)
    found.checks.append(judged("joint_range", "depth:together", worst, limit, evidence=shown))


def _gaps(probe: Probe, options: VerifyOptions) -> Iterator[Check]:
    """Yield how much air there is at rest between each part and what it hangs on."""
    low, high = bounds(probe.spec)
    slack = max(options.touch_gap_m, 0.01 * float(np.linalg.norm(high - low)))
    reach = 20 * slack
    limit = Limit(threshold=slack, unit="m", fault=Fault.PART_DETACHED)
    for joint in probe.spec.joints:
        if helper(probe.spec.part(joint.child)) or helper(probe.spec.part(joint.parent)):
            continue
        one, two = (probe.of_part(probe.names.index(name)) for name in (joint.parent, joint.child))
        near = probe.nearest(one, two, reach)
        gap = reach if near is None else max(near.distance, 0.0)
        told = f"{joint.child} hangs in the air beside {joint.parent}"
        yield judged(
            "static", f"gap:{joint.name}", gap, limit, part=joint.child, joint=joint.name,
            evidence=told,
        )  # fmt: skip


def _pivot(probe: Probe, joint: JointSpec, options: VerifyOptions) -> Check:
    """Measure how far the axis of a turning joint passes beside the two parts that it joins."""
    low, high = probe.extent(probe.names.index(joint.child))
    size = float(np.linalg.norm(high - low))
    point, axis = np.array(joint.pos), np.array(joint.axis)
    off = line_misses(point, axis, low, high)
    if not helper(probe.spec.part(joint.parent)):
        # The parent's frame need not reach all the way to the axis, as a hinge has its own size.
        off = max(off, line_misses(point, axis, *probe.extent(probe.names.index(joint.parent))) / 2)
    limit = Limit(
        threshold=max(options.max_pivot_off * size, 0.004), unit="m", fault=Fault.PIVOT_OFF
    )
    return judged(
        "static", f"pivot:{joint.name}", off, limit, part=joint.child, joint=joint.name,
        evidence=f"the axis of {joint.name} passes beside {joint.child} or {joint.parent}",
    )  # fmt: skip


def line_misses(point: NDArray, axis: NDArray, low: NDArray, high: NDArray) -> float:
    """Return how far [m] a box must grow on all sides to be met by a line."""
    least, most = 0.0, float(np.abs(np.concatenate([low - point, high - point])).max()) + 1.0
    for _ in range(40):
        grow = (least + most) / 2
        a, b = low - grow - point, high + grow - point
        inside = np.where((a <= 0) & (b >= 0), np.inf, -np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            near = np.where(axis == 0, -inside, np.minimum(a / axis, b / axis))
            far = np.where(axis == 0, inside, np.maximum(a / axis, b / axis))
        if near.max() <= far.min():
            most = grow
        else:
            least = grow
    return most if most > 1e-9 else 0.0


def intents(spec: ObjectSpec) -> Iterator[Check]:
    """Yield whether joints do what they are declared to do."""
    for joint in spec.joints:
        intent = joint.intent
        if intent is None:
            if joint.type in SINGLE:
                yield skipped("intent", joint.name, "no intent is declared", joint.name)
            continue
        if intent.type is not None:
            wrong = 0.0 if intent.type == joint.type else 1.0
            limit = Limit(threshold=0.0, unit="", fault=Fault.JOINT_TYPE)
            told = f"{joint.name} is {joint.type} and meant to be {intent.type}"
            yield judged(
                "intent", f"type:{joint.name}", wrong, limit, part=joint.child, joint=joint.name,
                evidence=told,
            )  # fmt: skip
            if wrong:
                continue
        if intent.opens is not None and joint.type in SINGLE:
            limit = Limit(threshold=0.3, unit="cosine", fault=Fault.AXIS_REVERSED, least=True)
            cosine = opening_alignment(spec, joint)
            if cosine is None:
                why = "its middle hardly moves, so it opens no way"
                yield skipped("intent", f"opens:{joint.name}", why, joint.name)
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


def positions(joint: JointSpec, steps: int) -> NDArray:
    """Return values that cover a joint's range; of a ball, how far it turns away from rest [rad]."""
    if joint.type == "continuous":
        return np.linspace(0, 2 * np.pi, steps + 3, endpoint=False)
    lower, upper = joint.lower, joint.upper
    if joint.type == "ball":
        # Each is tried in many directions, so fewer do.
        upper, steps = upper or np.pi, max(steps // 2, 3)
    values = np.linspace(lower, upper, steps)
    # The first and last bit of a range are where it meets what stops it.
    edge = 0.02 * (upper - lower)
    return np.unique(np.concatenate([values, [lower + edge, upper - edge]]))


def states(joint: JointSpec, value: float) -> list[dict[str, float]]:
    """Return the states in which a joint stands at a value: a ball turned by it in 26 directions."""
    if joint.type != "ball":
        return [{joint.name: value}]
    if value == 0.0:
        return [{f"{joint.name}.{axis}": 0.0 for axis in "xyz"}]
    return [
        {f"{joint.name}.{axis}": value * w for axis, w in zip("xyz", way, strict=True)}
        for way in _WAYS
    ]


def carried(spec: ObjectSpec, joint: JointSpec) -> set[str]:
    """Return the parts that a joint moves, those of its followers included."""
    led = {joint.name}
    for _ in spec.joints:
        led |= {j.name for j in spec.joints if j.mimic is not None and j.mimic.joint in led}
    moved: set[str] = set()
    for part, carrier in spec.ordered:
        if carrier is not None and (carrier.name in led or carrier.parent in moved):
            moved.add(part.name)
    return moved


def with_joint(spec: ObjectSpec, joint: JointSpec) -> ObjectSpec:
    """Return the object with a joint in place of its namesake."""
    joints = tuple(joint if j.name == joint.name else j for j in spec.joints)
    return spec.model_copy(update={"joints": joints})


__all__ = [
    "JointSweepChecks",
    "carried",
    "intents",
    "line_misses",
    "on_edge",
    "pivot_edges",
    "positions",
    "ranges",
    "states",
    "with_joint",
]

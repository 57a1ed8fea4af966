"""Parts that enter each other, measured over every joint's range, parent and child included."""

import itertools
from collections.abc import Sequence

import numpy as np

from ..config import ProgramOptions
from ..spec import JointSpec, ObjectSpec
from ..spec.opening import prerequisite_state, with_prerequisites
from .allowance import Allowance
from .probe import Near, Probe
from .signals import Signal

Pair = tuple[int, int]
State = dict[str, float]


def overlaps(
    probe: Probe, options: ProgramOptions, allowances: Sequence[Allowance] = ()
) -> list[Signal]:
    """Find parts that enter each other at rest, over each joint's range, and in combinations.

    A joint that waits for others (`after`) is moved while these stand open, and in combinations only then;
    they themselves are moved while it is at rest. Parts that are fastened to each other may overlap. What is
    found deepest of a pair is told.
    """
    spec = probe.spec
    limits = _limits(probe, options, allowances)
    rigid = _welded(spec)
    every = [
        (a, b)
        for a, b in itertools.combinations(range(len(probe.names)), 2)
        if rigid[probe.names[a]] != rigid[probe.names[b]]
    ]
    found, bad = [], set()
    for pair, near in probe.depths(every).items():
        if -near.distance > limits[pair]:
            bad.add(pair)
            found.append(_overlap(probe, pair, near, limits[pair]))
    rest = [pair for pair in every if pair not in bad]
    driven = [j for j in spec.joints if j.type != "fixed" and j.mimic is None]
    for joint in driven:
        moving = {probe.names.index(name) for name in _carried(spec, joint)}
        pairs = [pair for pair in rest if (pair[0] in moving) != (pair[1] in moving)]
        if _follows(spec, joint):
            pairs += [pair for pair in rest if pair[0] in moving and pair[1] in moving]
        opened = prerequisite_state(spec, joint)
        worst = _swept(probe, joint, opened, pairs, limits, options)
        for pair, (distance, state) in worst.items():
            found.append(_collision(probe, pair, joint, -distance, state, moving, limits[pair]))
        bad |= set(worst)
        if not bad:
            found += _needless(probe, joint, opened, pairs, limits, options)
    rest = [pair for pair in every if pair not in bad]
    if len(driven) > 1:
        found += _combinations(probe, driven, rest, limits, options)
    probe.place({})
    return found


def _swept(
    probe: Probe,
    joint: JointSpec,
    others: State,
    pairs: list[Pair],
    limits: dict[Pair, float],
    options: ProgramOptions,
) -> dict[Pair, tuple[float, State]]:
    """Return the pairs that are too deep while a joint moves: distance [m] and the joint's state."""
    tried = np.array(pairs, dtype=int)
    worst: dict[Pair, tuple[float, State]] = {}
    for state in _positions(joint, options.sweep_steps):
        probe.place({**others, **state})
        for pair, near in probe.depths(tried).items():
            if near.distance < worst.get(pair, (-limits[pair], {}))[0]:
                worst[pair] = (near.distance, state)
    return worst


def _needless(
    probe: Probe,
    joint: JointSpec,
    opened: State,
    pairs: list[Pair],
    limits: dict[Pair, float],
    options: ProgramOptions,
) -> list[Signal]:
    """Refuse to let a joint wait for one that is in nobody's way: it would be tried less for nothing."""
    found = []
    for name in joint.after:
        other = next(j for j in probe.spec.joints if j.name == name)
        closed = {key: value for key, value in opened.items() if key != name}
        if _swept(probe, joint, closed, pairs, limits, options):
            continue
        found.append(
            Signal(
                severity="error",
                code="after_needless",
                joint=joint.name,
                part=joint.child,
                message=f"joint {joint.name!r} waits for {name!r}, but {other.child!r} is not in its way "
                "when closed",
                hint="leave after= out",
            )
        )
    return found


def _combinations(
    probe: Probe,
    driven: list[JointSpec],
    rest: list[Pair],
    limits: dict[Pair, float],
    options: ProgramOptions,
) -> list[Signal]:
    random = np.random.default_rng(0)
    worst: dict[Pair, tuple[float, str]] = {}
    reach = [_positions(joint, options.sweep_steps) for joint in driven]
    tried = np.array(rest, dtype=int)
    for k in range(options.sweep_combinations):
        # All open and all closed come first: that is where what swings past each other meets.
        index = [(-1, 0)[k] if k < 2 else random.integers(len(values)) for values in reach]
        state = {}
        for values, i in zip(reach, index, strict=True):
            state |= values[i]
        state = with_prerequisites(probe.spec, state, opening=k % 2 == 0)
        probe.place(state)
        for pair, near in probe.depths(tried).items():
            if near.distance < worst.get(pair, (-limits[pair], ""))[0]:
                shown = ", ".join(f"{name} at {value:.3g}" for name, value in state.items())
                worst[pair] = (near.distance, shown)
    return [
        Signal(
            severity="error",
            code="overlap_in_combination",
            part=probe.names[b],
            message=f"parts {probe.names[a]!r} and {probe.names[b]!r} enter each other with "
            f"{shown[:200]}",
            value=-distance,
            threshold=limits[a, b],
            hint="leave the parts room when several joints are open at once, or shorten a range",
        )
        for (a, b), (distance, shown) in worst.items()
    ]


def _positions(joint: JointSpec, steps: int) -> list[State]:
    """List where a joint is tried, closed first and opened last."""
    if joint.type == "ball":
        far = joint.upper if joint.upper > 0 else np.pi
        keys = [f"{joint.name}.{axis}" for axis in "xyz"]
        # Along each axis and each diagonal, at half and at the whole of its range.
        signs = [np.array(s, float) for s in itertools.product((-1, 0, 1), repeat=3) if any(s)]
        turns = [k * far * s / np.linalg.norm(s) for k in (0.5, 1.0) for s in signs]
        return [dict(zip(keys, map(float, turn), strict=True)) for turn in (np.zeros(3), *turns)]
    if joint.type == "continuous":
        values = np.linspace(0, 2 * np.pi, steps + 3, endpoint=False)
    else:
        values = np.linspace(joint.lower, joint.upper, steps)
    return [{joint.name: float(value)} for value in values]


def _carried(spec: ObjectSpec, joint: JointSpec) -> set[str]:
    """Return the parts that a joint moves, those of its followers included."""
    led = {joint.name}
    for _ in spec.joints:
        led |= {j.name for j in spec.joints if j.mimic is not None and j.mimic.joint in led}
    moved: set[str] = set()
    for part, carrier in spec.ordered:
        if carrier is not None and (carrier.name in led or carrier.parent in moved):
            moved.add(part.name)
    return moved


def _follows(spec: ObjectSpec, joint: JointSpec) -> bool:
    return any(j.mimic is not None and j.mimic.joint == joint.name for j in spec.joints)


def _welded(spec: ObjectSpec) -> dict[str, str]:
    """Name for every part the rigid group that it belongs to."""
    group: dict[str, str] = {}
    for part, joint in spec.ordered:
        rigid = joint is not None and joint.type == "fixed"
        group[part.name] = group[joint.parent] if rigid and joint is not None else part.name
    return group


def _limits(
    probe: Probe, options: ProgramOptions, allowances: Sequence[Allowance]
) -> dict[Pair, float]:
    """Return how deep [m] every two parts may enter each other."""
    granted = {frozenset((a.first, a.second)): a.depth for a in allowances}
    limits = {}
    for a, b in itertools.combinations(range(len(probe.names)), 2):
        named = frozenset((probe.names[a], probe.names[b]))
        limits[a, b] = max(options.max_depth_m, granted.get(named, 0.0))
    return limits


def _overlap(probe: Probe, pair: Pair, near: Near, limit: float) -> Signal:
    a, b = (probe.names[index] for index in pair)
    shapes = (probe.geom_names[probe.geom[k]] for k in (near.first, near.second))
    return Signal(
        severity="error",
        code="overlap_at_rest",
        part=b,
        message=f"parts {a!r} and {b!r} enter each other at rest, at {' and '.join(shapes)}",
        value=-near.distance,
        threshold=limit,
        hint="parts that move against each other may touch, not overlap: leave 0.5 to 1 mm",
    )


def _collision(
    probe: Probe,
    pair: Pair,
    joint: JointSpec,
    depth: float,
    state: State,
    moving: set[int],
    limit: float,
) -> Signal:
    a, b = sorted(pair, key=lambda index: index in moving)
    unit = "m" if joint.type == "prismatic" else "rad"
    at = ", ".join(f"{value:.3g}" for value in state.values())
    at = f"({at})" if joint.type == "ball" else at
    return Signal(
        severity="error",
        code="overlap_in_motion",
        joint=joint.name,
        part=probe.names[b],
        message=f"joint {joint.name!r} at {at} {unit} drives {probe.names[b]!r} into "
        f"{probe.names[a]!r}" + (f", with {' and '.join(joint.after)} open" if joint.after else ""),
        value=depth,
        threshold=limit,
        hint="check the sign of the axis (positive opens), the anchor, the range and the clearance; "
        "what moves only when a door is open says after=",
    )

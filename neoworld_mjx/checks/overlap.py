"""Signals for parts that overlap, with joints at zero, over a joint's range or in combinations."""

import itertools
from collections.abc import Iterator, Sequence

from ..config import ProgramOptions
from .allowance import Allowance
from .joint_sweep import (
    JointRange,
    JointSweep,
    Overlap,
    Pair,
    sweep_combinations,
    sweep_joints,
    sweep_range,
)
from .part_distances import Probe
from .signals import Signal, error_signal


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
        if not signals:
            signals += _needless_prerequisites(sweep, swept, options)
    for pair, overlap in sweep_combinations(sweep, options).items():
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


def _needless_prerequisites(
    sweep: JointSweep, swept: JointRange, options: ProgramOptions
) -> Iterator[Signal]:
    """Yield an error for each prerequisite that, when closed, does not obstruct the joint.

    A prerequisite excludes states from the sweep, so needless prerequisites are not allowed.
    """
    joint = swept.joint
    for name in joint.after:
        prerequisite = sweep.probe.spec.joint(name)
        others_open = {key: value for key, value in swept.prerequisites.items() if key != name}
        alone = sweep_range(
            sweep.probe, joint, swept.pairs, sweep.allowed, options.sweep_steps, others_open
        )
        if not sweep.too_deep(alone.deepest):
            message = f"joint {joint.name!r} waits for {name!r}, but {prerequisite.child!r} is not "
            message += "in its way when closed"
            names = {"joint": joint.name, "part": joint.child}
            yield error_signal("after_needless", message, hint="leave after= out", **names)


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
        "clearance; what moves only when a door is open says after=",
    )

"""Signals for parts that enter each other at rest, over a joint's range, or in combinations."""

import itertools
from collections.abc import Sequence

from ..config import ProgramOptions
from .allowance import Allowance
from .joint_sweep import (
    JointRange,
    JointSweep,
    Overlap,
    Pair,
    sweep_joints,
    sweep_range,
    sweep_together,
)
from .part_distances import Probe
from .signals import Signal


def overlap_signals(
    probe: Probe, options: ProgramOptions, allowances: Sequence[Allowance] = ()
) -> list[Signal]:
    """Return a signal for every pair of parts that overlap too deep, where they are deepest.

    A joint that waits for others (`after`) is moved while these are open, in combinations too; they
    themselves are moved while it is at rest.
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
            signals += _needless(sweep, swept, options)
    signals += [
        _in_combination(probe, pair, overlap, sweep.allowed[pair])
        for pair, overlap in sweep_together(sweep, options).items()
    ]
    return signals


def rest_overlap_signals(probe: Probe, options: ProgramOptions) -> list[Signal]:
    """Return a signal for every two parts that overlap too deep at rest, whatever joins them."""
    most = options.max_depth_m
    probe.place({})
    pairs = dict.fromkeys(itertools.combinations(range(len(probe.names)), 2), most)
    return [
        _at_rest(probe, pair, Overlap(-near.distance, near, {}), most)
        for pair, near in probe.depths(pairs).items()
        if -near.distance > most
    ]


def _needless(sweep: JointSweep, swept: JointRange, options: ProgramOptions) -> list[Signal]:
    """Return an error for each joint that another waits for although it is not in its way.

    Waiting leaves states out of the sweep, so it must be needed.
    """
    joint, signals = swept.joint, []
    for name in joint.after:
        other = sweep.probe.spec.joint(name)
        closed = {key: value for key, value in swept.opened.items() if key != name}
        alone = sweep_range(
            sweep.probe, joint, swept.pairs, sweep.allowed, options.sweep_steps, closed
        )
        if sweep.too_deep(alone.deepest):
            continue
        signals.append(
            Signal(
                severity="error",
                code="after_needless",
                joint=joint.name,
                part=joint.child,
                message=f"joint {joint.name!r} waits for {name!r}, but {other.child!r} is not "
                "in its way when closed",
                hint="leave after= out",
            )
        )
    return signals


def _at_rest(probe: Probe, pair: Pair, overlap: Overlap, allowed: float) -> Signal:
    a, b = (probe.names[index] for index in pair)
    pieces = (overlap.near.first, overlap.near.second)
    shapes = (probe.geom_names[probe.geom[piece]] for piece in pieces)
    return Signal(
        severity="error",
        code="overlap_at_rest",
        part=b,
        message=f"parts {a!r} and {b!r} enter each other at rest, at {' and '.join(shapes)}",
        value=overlap.depth,
        threshold=allowed,
        hint="parts that move against each other may touch, not overlap: leave 0.5 to 1 mm",
    )


def _in_motion(
    probe: Probe, swept: JointRange, pair: Pair, overlap: Overlap, allowed: float
) -> Signal:
    joint = swept.joint
    a, b = sorted(pair, key=lambda index: index in swept.moving)
    unit = "m" if joint.type == "prismatic" else "rad"
    at = ", ".join(f"{value:.3g}" for value in overlap.state.values())
    at = f"({at})" if joint.type == "ball" else at
    return Signal(
        severity="error",
        code="overlap_in_motion",
        joint=joint.name,
        part=probe.names[b],
        message=f"joint {joint.name!r} at {at} {unit} drives {probe.names[b]!r} into "
        f"{probe.names[a]!r}" + (f", with {' and '.join(joint.after)} open" if joint.after else ""),
        value=overlap.depth,
        threshold=allowed,
        hint="check the sign of the axis (positive opens), the anchor, the range and the "
        "clearance; what moves only when a door is open says after=",
    )


def _in_combination(probe: Probe, pair: Pair, overlap: Overlap, allowed: float) -> Signal:
    a, b = (probe.names[index] for index in pair)
    state = ", ".join(f"{name} at {value:.3g}" for name, value in overlap.state.items())
    return Signal(
        severity="error",
        code="overlap_in_combination",
        part=b,
        message=f"parts {a!r} and {b!r} enter each other with {state[:200]}",
        value=overlap.depth,
        threshold=allowed,
        hint="leave the parts room when several joints are open at once, or shorten a range",
    )

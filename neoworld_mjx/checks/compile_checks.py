"""Compile checks of an object (paper Section 3.2, Step 2), independent of its program.

At rest, every part is connected, touches its parent, and overlaps no other part. In motion, no two
parts overlap anywhere over the joints' ranges, one joint at a time and in sampled combinations. A
joint's axis passes through its child, and its range moves the child. Sizes and masses are those of
real objects.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from ..config import ProgramOptions
from ..spec import JointSpec, ObjectSpec
from ..spec.opening import opening_alignment
from .allowance import Allowance
from .overlap import overlap_signals
from .part_distances import OutOfTime, Probe, line_box_distance
from .plausibility import plausibility
from .signals import Signal, deduplicated, in_radians

AXIS_SLACK = 0.05
"""Largest distance between an axis and the part it turns, over that part's diagonal."""
LEAST_TURN_RAD, LEAST_SLIDE = 0.03, 0.01
"""Smallest range of a joint that turns [rad], and of one that slides, over the child's diagonal."""
OPENS_COSINE = 0.3
"""Least cosine between the direction in which a part begins to move and the declared one."""
LONGEST_SLIDE = 1.5
"""Largest range of a sliding joint, over the object's diagonal."""


def check(
    spec: ObjectSpec,
    options: ProgramOptions | None = None,
    lines: dict[str, int] | None = None,
    allowances: Sequence[Allowance] = (),
) -> tuple[Signal, ...]:
    """Run all compile checks on an object.

    Args:
        spec: the object.
        options: thresholds and the number of positions of the joint sweep.
        lines: the program's line of each part and joint, as in `BuildResult.lines`.
        allowances: overlaps that the program declares.

    Returns:
        Each finding once, errors first; empty for a valid object without warnings.
    """
    options = options or ProgramOptions()
    signals = list(plausibility(spec))
    signals += [
        Signal(
            severity="warning",
            code="allowed_overlap",
            part=allowed.second,
            message=f"{allowed.first!r} and {allowed.second!r} may enter each other: "
            f"{allowed.reason}",
            value=allowed.depth,
            threshold=options.max_depth_m,
        )
        for allowed in allowances
    ]
    try:
        probe = Probe(spec, options.check_timeout_s)
        signals += loose_shapes(probe, options)
        signals += _joints(probe)
        signals += overlap_signals(probe, options, allowances)
    except OutOfTime:
        signals.append(too_intricate(options))
    return deduplicated(with_line(signal, lines or {}) for signal in signals)


def too_intricate(options: ProgramOptions) -> Signal:
    """Return the error of an object whose check takes too long."""
    return Signal(
        severity="error",
        code="too_intricate",
        message="the object could not be checked in the time allowed",
        threshold=options.check_timeout_s,
        value=options.check_timeout_s,
        hint="use fewer shapes, lathe sectors or parts that overlap",
    )


def with_line(signal: Signal, lines: dict[str, int]) -> Signal:
    """Add the line where the signal's joint or part was made."""
    key = f"joint:{signal.joint}" if signal.joint is not None else f"part:{signal.part}"
    if signal.line is None and key in lines:
        return signal.model_copy(update={"line": lines[key]})
    return signal


def loose_shapes(probe: Probe, options: ProgramOptions) -> list[Signal]:
    """Find shapes of a part that touch neither the rest of it nor the part it is attached to."""
    spec, reach, signals = probe.spec, options.touch_gap_m + 1e-6, []
    joints = {joint.child: joint for joint in spec.joints}
    for index, part in enumerate(spec.parts):
        own = probe.of_part(index)
        geoms = list(dict.fromkeys(probe.geom[own].tolist()))
        pieces = {geom: own[probe.geom[own] == geom] for geom in geoms}
        # Connected components: each geom has the label of the component that it belongs to.
        component = {geom: geom for geom in geoms}
        for a, b in itertools.combinations(geoms, 2):
            if component[a] == component[b]:
                continue
            if probe.nearest(pieces[a], pieces[b], reach) is not None:
                merged, label = component[b], component[a]
                component = {g: label if c == merged else c for g, c in component.items()}
        members = {
            label: [geom for geom in geoms if component[geom] == label]
            for label in dict.fromkeys(component.values())
        }
        joint = joints.get(part.name)
        attached = dict.fromkeys(members, False)
        if joint is not None:
            parent = probe.of_part(probe.names.index(joint.parent))
            for label, shapes in members.items():
                touching = own[np.isin(probe.geom[own], shapes)]
                attached[label] = probe.nearest(touching, parent, reach) is not None
            if not any(attached.values()):
                signals.append(_detached(probe, index, joint, options))
                attached[next(iter(attached))] = True
        # The largest component is the part; the others must be attached to the parent.
        main = max(members, key=lambda label: (attached[label], len(members[label])))
        for label, shapes in members.items():
            if label == main or attached[label]:
                continue
            names = [probe.geom_names[geom] for geom in shapes]
            signals.append(
                Signal(
                    severity="error",
                    code="loose_shape",
                    part=part.name,
                    message=f"part {part.name!r}: {', '.join(names[:4])} "
                    f"{'touches' if len(names) == 1 else 'touch'} nothing else of the part",
                    threshold=options.touch_gap_m,
                    hint="move the shape until it touches, or add what holds it",
                )
            )
    return signals


def _detached(probe: Probe, index: int, joint: JointSpec, options: ProgramOptions) -> Signal:
    """Return the error of a part that does not touch its parent, with the gap between them."""
    parent = probe.names.index(joint.parent)
    near = probe.nearest(probe.of_part(index), probe.of_part(parent), 100.0)
    return Signal(
        severity="error",
        code="detached_part",
        part=joint.child,
        message=f"part {joint.child!r} does not touch {joint.parent!r}, which joint "
        f"{joint.name!r} attaches it to",
        value=None if near is None else near.distance,
        threshold=options.touch_gap_m,
        hint="close the gap, or attach the part to the one that it touches",
    )


def _joints(probe: Probe) -> list[Signal]:
    """Check the axis, the range and the declared direction of every joint that moves."""
    signals = []
    whole = float(np.linalg.norm(probe.high.max(axis=0) - probe.low.min(axis=0)))
    for joint in probe.spec.joints:
        if joint.type == "fixed":
            continue
        child = probe.names.index(joint.child)
        box = probe.extent(child)
        size = float(np.linalg.norm(box[1] - box[0]))
        if joint.type == "ball":
            pivot = np.array(joint.pos)
            miss = float(np.linalg.norm(np.maximum(np.maximum(box[0] - pivot, pivot - box[1]), 0)))
            if miss > AXIS_SLACK * size:
                hint = "put `at` where the ball sits, on the part that it turns"
                message = f"the ball lies beside part {joint.child!r}"
                signals.append(
                    _joint_error(joint, "axis_off", message, hint, miss, AXIS_SLACK * size)
                )
        elif joint.type != "prismatic":
            miss = line_box_distance(np.array(joint.pos), np.array(joint.axis), *box)
            if miss > AXIS_SLACK * size:
                signals.append(
                    _joint_error(
                        joint,
                        "axis_off",
                        f"the axis passes beside part {joint.child!r}",
                        "put `at` on the hinge: an edge or the middle of the part that turns",
                        miss,
                        AXIS_SLACK * size,
                    )
                )
        signals += _range(joint, size, whole)
        if joint.intent is not None and joint.intent.opens is not None:
            signals += _opens(probe.spec, joint)
    return signals


def _range(joint: JointSpec, size: float, whole: float) -> list[Signal]:
    """Check a joint's limits against the diagonals [m] of its child and of the whole object."""
    if joint.type == "continuous" or (joint.type == "ball" and joint.upper == 0.0):
        return []
    signals = []
    width = joint.upper - joint.lower
    slides = joint.type == "prismatic"
    least = LEAST_SLIDE * size if slides else LEAST_TURN_RAD
    most = LONGEST_SLIDE * whole if slides else 2 * np.pi + 1e-6
    if width < least:
        hint = "give the range that the real thing has"
        signals.append(
            _joint_error(joint, "range_small", "the range moves nothing", hint, width, least)
        )
    if width > most:
        hint = "shorten the range" if slides else "use continuous for what turns without end"
        far = max(abs(joint.lower), abs(joint.upper))
        if not slides and far > 3 * math.pi:
            hint = in_radians(far)
        elif slides and far > 10 * most:
            hint = f"lengths are in metres: {far:g} mm are {far / 1000:g}"
        signals.append(
            _joint_error(joint, "range_large", "the range is too large", hint, width, most)
        )
    if not joint.lower - 1e-9 <= 0.0 <= joint.upper + 1e-9:
        nearest = joint.lower if joint.lower > 0 else joint.upper
        hint = "shapes are drawn at 0, so the range must hold 0"
        message = "the range leaves out 0, where the object is drawn"
        signals.append(_joint_error(joint, "rest_outside", message, hint, 0.0, nearest))
    return signals


def _opens(spec: ObjectSpec, joint: JointSpec) -> list[Signal]:
    """Check that positive moves the child in the direction that `opens` declares."""
    cosine = opening_alignment(spec, joint)
    if cosine is None:
        message = "opens= names a way, but the middle of what it turns hardly moves"
        return [_joint_error(joint, "opens_no_way", message, "leave opens= out", 0.0, OPENS_COSINE)]
    if cosine >= OPENS_COSINE:
        return []
    message = f"positive does not move {joint.child!r} the way that opens= names"
    hint = "turn the axis around, or put `at` on the opposite edge (positive opens)"
    return [_joint_error(joint, "opens_wrong_way", message, hint, cosine, OPENS_COSINE)]


def _joint_error(
    joint: JointSpec, code: str, message: str, hint: str, value: float, threshold: float
) -> Signal:
    return Signal(
        severity="error",
        code=code,
        joint=joint.name,
        part=joint.child,
        message=f"joint {joint.name!r}: {message}",
        value=float(value),
        threshold=float(threshold),
        hint=hint,
    )

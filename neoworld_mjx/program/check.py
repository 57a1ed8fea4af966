"""Compile checks of an object (paper Section 3.2, Step 2), independent of its program.

At rest: every part holds together, touches what it is attached to, and enters no other part. In
motion: no two parts enter each other anywhere over the joints' ranges, one joint at a time and in
sampled combinations. Joints: the axis lies on what it moves, the range moves something. And sizes
and masses are those of real things.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from ..config import ProgramOptions
from ..spec import JointSpec, ObjectSpec
from ..spec.opening import opening_alignment
from .allowance import Allowance
from .overlap import overlap_signals
from .plausible import plausibility
from .probe import OutOfTime, Probe, line_box_distance
from .signals import Signal, deduplicated

AXIS_SLACK = 0.05
"""Distance by which an axis may pass beside the part it turns, over that part's diagonal."""
LEAST_TURN_RAD, LEAST_SLIDE = 0.03, 0.01
"""Smallest range: of a turn, and of a slide over the child's diagonal."""
OPENS_COSINE = 0.3
"""Least cosine between the direction in which a part sets out and the declared one."""
LONGEST_SLIDE = 1.5
"""Of a slide, over the object's diagonal."""


def check(
    spec: ObjectSpec,
    options: ProgramOptions | None = None,
    lines: dict[str, int] | None = None,
    allowances: Sequence[Allowance] = (),
) -> tuple[Signal, ...]:
    """Check an object.

    Args:
        spec: the object.
        options: thresholds and how finely ranges are swept.
        lines: where parts and joints were made, as `Built.lines` has it.
        allowances: overlaps that the program asks for by name.

    Returns:
        Each finding once; nothing when the object is valid.
    """
    options = options or ProgramOptions()
    found = list(plausibility(spec))
    found += [
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
        found += _loose(probe, options)
        found += _joints(probe, options)
        found += overlap_signals(probe, options, allowances)
    except OutOfTime:
        found.append(
            Signal(
                severity="error",
                code="too_intricate",
                message="the object could not be checked in the time allowed",
                threshold=options.check_timeout_s,
                value=options.check_timeout_s,
                hint="use fewer shapes, lathe sectors or parts that overlap",
            )
        )
    return deduplicated(_placed(signal, lines or {}) for signal in found)


def _placed(signal: Signal, lines: dict[str, int]) -> Signal:
    key = f"joint:{signal.joint}" if signal.joint is not None else f"part:{signal.part}"
    if signal.line is None and key in lines:
        return signal.model_copy(update={"line": lines[key]})
    return signal


def _loose(probe: Probe, options: ProgramOptions) -> list[Signal]:
    """Find shapes of a part that touch neither the rest of it nor what it is attached to."""
    spec, gap, found = probe.spec, options.touch_gap_m, []
    carrier = {joint.child: joint.parent for joint in spec.joints}
    for index, part in enumerate(spec.parts):
        own = probe.of_part(index)
        geoms = list(dict.fromkeys(probe.geom[own].tolist()))
        group = {g: g for g in geoms}
        for a, b in itertools.combinations(geoms, 2):
            if group[a] == group[b]:
                continue
            one, two = own[probe.geom[own] == a], own[probe.geom[own] == b]
            if probe.nearest(one, two, gap + 1e-6) is not None:
                old, new = group[b], group[a]
                group = {g: new if at == old else at for g, at in group.items()}
        others = []
        if part.name in carrier:
            others.append(probe.names.index(carrier[part.name]))
        held = {}
        for root in dict.fromkeys(group.values()):
            members = own[np.isin(probe.geom[own], [g for g in geoms if group[g] == root])]
            held[root] = any(
                probe.nearest(members, probe.of_part(other), gap + 1e-6) for other in others
            )
        joint = next((j for j in spec.joints if j.child == part.name), None)
        if joint is not None and not any(held.values()):
            found.append(_apart(probe, index, joint, options))
            held[next(iter(held))] = True
        # The biggest island is the part; other islands may be attached to the parent instead.
        main = max(held, key=lambda r: (held[r], sum(at == r for at in group.values())))
        for root, attached in held.items():
            if root == main or attached:
                continue
            shapes = [probe.geom_names[g] for g in geoms if group[g] == root]
            found.append(
                Signal(
                    severity="error",
                    code="loose_shape",
                    part=part.name,
                    message=f"part {part.name!r}: {', '.join(shapes[:4])} "
                    f"{'touches' if len(shapes) == 1 else 'touch'} nothing else of the part",
                    threshold=gap,
                    hint="move the shape until it touches, or add what holds it",
                )
            )
    return found


def _apart(probe: Probe, index: int, joint: JointSpec, options: ProgramOptions) -> Signal:
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


def _joints(probe: Probe, options: ProgramOptions) -> list[Signal]:
    found = []
    low = np.min([probe.extent(i)[0] for i in range(len(probe.names))], axis=0)
    high = np.max([probe.extent(i)[1] for i in range(len(probe.names))], axis=0)
    whole = float(np.linalg.norm(high - low))
    for joint in probe.spec.joints:
        if joint.type == "fixed":
            continue
        child = probe.names.index(joint.child)
        box = probe.extent(child)
        size = float(np.linalg.norm(box[1] - box[0]))
        if joint.type == "ball":
            at = np.array(joint.pos)
            miss = float(np.linalg.norm(np.maximum(np.maximum(box[0] - at, at - box[1]), 0.0)))
            if miss > AXIS_SLACK * size:
                hint = "put `at` where the ball sits, on the part that it turns"
                message = f"the ball lies beside part {joint.child!r}"
                found.append(_of_joint(joint, "axis_off", message, hint, miss, AXIS_SLACK * size))
        elif joint.type != "prismatic":
            miss = line_box_distance(np.array(joint.pos), np.array(joint.axis), *box)
            if miss > AXIS_SLACK * size:
                found.append(
                    _of_joint(
                        joint,
                        "axis_off",
                        f"the axis passes beside part {joint.child!r}",
                        "put `at` on the hinge: an edge or the middle of the part that turns",
                        miss,
                        AXIS_SLACK * size,
                    )
                )
        found += _range(joint, size, whole)
        if joint.intent is not None and joint.intent.opens is not None:
            found += _opens(probe.spec, joint)
    return found


def _range(joint: JointSpec, size: float, whole: float) -> list[Signal]:
    if joint.type == "continuous" or (joint.type == "ball" and joint.upper == 0.0):
        return []
    found = []
    width = joint.upper - joint.lower
    slides = joint.type == "prismatic"
    least = LEAST_SLIDE * size if slides else LEAST_TURN_RAD
    most = LONGEST_SLIDE * whole if slides else 2 * np.pi + 1e-6
    if width < least:
        hint = "give the range that the real thing has"
        found.append(_of_joint(joint, "range_small", "the range moves nothing", hint, width, least))
    if width > most:
        hint = "shorten the range" if slides else "use continuous for what turns without end"
        found.append(_of_joint(joint, "range_large", "the range is too large", hint, width, most))
    if not joint.lower - 1e-9 <= 0.0 <= joint.upper + 1e-9:
        nearest = joint.lower if joint.lower > 0 else joint.upper
        hint = "shapes are drawn at 0, so the range must hold 0"
        message = "the range leaves out 0, where the object is drawn"
        found.append(_of_joint(joint, "rest_outside", message, hint, 0.0, nearest))
    return found


def _opens(spec: ObjectSpec, joint: JointSpec) -> list[Signal]:
    cosine = opening_alignment(spec, joint)
    if cosine is None:
        message = "opens= names a way, but the middle of what it turns hardly moves"
        return [_of_joint(joint, "opens_no_way", message, "leave opens= out", 0.0, OPENS_COSINE)]
    if cosine >= OPENS_COSINE:
        return []
    message = f"positive does not move {joint.child!r} the way that opens= names"
    hint = "turn the axis around, or put `at` on the opposite edge (positive opens)"
    return [_of_joint(joint, "opens_wrong_way", message, hint, cosine, OPENS_COSINE)]


def _of_joint(
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

"""Compile checks of an object (paper Section 3.2, Step 2), independent of its program.

A valid object satisfies the following conditions:

- With all joints at zero, every part is connected, touches its parent, and overlaps no other part.
- No two parts overlap over the range of any joint, or in sampled combinations of joint positions.
- The axis of a joint passes through its child, and the joint's range moves the child.
- Sizes and masses are plausible for a real object.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet

from ..config import ProgramOptions
from ..spec import (
    JointSpec,
    ObjectSpec,
    PartSpec,
    bounds,
    inertial,
    is_too_light,
    pieces,
)
from ..spec.convex import volume_of_hull
from ..spec.mass import LEAST_KG
from ..spec.opening import opening_alignment
from ..spec.shapes import faceted
from .coplanar_faces import coplanar_faces
from .joint_sweep import TOUCH_GAP_M, overlap_signals, rest_overlap_signals
from .signals import Allowance, Signal, deduplicated, error_signal, radians_hint
from .static_checks import OutOfTime, Probe, line_box_distance

SMALLEST_M, LARGEST_M = 0.01, 20.0
"""Limits on the longest edge of an object [m]."""
HEAVIEST_KG = 2000.0
SOLID_KG_M3 = 3000.0
"""Largest mass of a part over the volume of its convex hull; only solid metal exceeds it."""
WEIGHED_KG = 1.0
"""Mass above which the limit on density applies; a lighter part is a fitting."""


def plausibility(spec: ObjectSpec) -> Iterator[Signal]:
    """Yield signals for implausible sizes and masses of an object."""
    low, high = bounds(spec)
    yield from _size(high - low)
    total = 0.0
    for part in spec.parts:
        inertia = inertial(spec, part)
        total += inertia.mass
        if is_too_light(inertia):
            yield error_signal(
                "too_light",
                f"part {part.name!r} weighs {inertia.mass:.3g} kg, too little to be simulated",
                value=inertia.mass,
                threshold=LEAST_KG,
                hint="make it larger or denser, or shapes of another part",
            )
            continue
        if part.mass is None:
            yield from _density(part.name, inertia.mass, inertia.mass / _hull_volume(part))
    if total > HEAVIEST_KG:
        hint = "lengths are in metres; make it hollow, or choose a lighter material"
        message = f"the object weighs {total:.4g} kg"
        yield error_signal("too_heavy", message, value=total, threshold=HEAVIEST_KG, hint=hint)


def _size(size: np.ndarray) -> Iterator[Signal]:
    longest = float(size.max())
    message = f"the object measures {' x '.join(f'{v:.4g}' for v in size)} m"
    hint = "lengths are in metres"
    if longest > LARGEST_M:
        yield error_signal("size", message, value=longest, threshold=LARGEST_M, hint=hint)
    if longest < SMALLEST_M:
        yield error_signal("size", message, value=longest, threshold=SMALLEST_M, hint=hint)


def _density(part: str, mass: float, density: float) -> Iterator[Signal]:
    """Check a part's density [kg/m^3], which is the mass over the volume of the convex hull."""
    if mass > WEIGHED_KG and density > SOLID_KG_M3:
        yield error_signal(
            "too_heavy",
            f"part {part!r} weighs {mass:.3g} kg, {density:.0f} kg for each m^3 that it spans: "
            "that is solid metal",
            part=part,
            value=density,
            threshold=SOLID_KG_M3,
            hint="make it a shell (lathe with thickness, hollow_box); if it is solid, say so by "
            "mass=",
        )


def _hull_volume(part: PartSpec) -> float:
    """Return the volume of a part's convex hull [m^3]."""
    corners = [pose.apply(faceted(piece, 16)) for _, piece, pose in pieces(part)]
    return volume_of_hull(np.vstack(corners)) or 1e-12


AXIS_SLACK = 0.05
"""Largest distance between a joint's axis and the joint's child, over the child's diagonal."""
MIN_TURN_RAD, MIN_SLIDE = 0.03, 0.01
"""Smallest range of a turning joint [rad], and of a sliding joint over the child's diagonal."""
MIN_OPENING_COSINE = 0.3
"""Smallest cosine of the angle between the initial direction of motion and the declared one."""
MAX_SLIDE = 1.5
"""Largest range of a sliding joint, over the object's diagonal."""


def check(
    spec: ObjectSpec,
    options: ProgramOptions | None = None,
    lines: Mapping[str, int] | None = None,
    allowances: Sequence[Allowance] = (),
) -> tuple[Signal, ...]:
    """Run all compile checks on an object.

    Args:
        spec: the object.
        options: the allowed depth and the limit on processor time.
        lines: line of the program that creates each part and joint, as in `BuildResult.lines`.
        allowances: overlaps that the program declares.

    Returns:
        The findings without duplicates, errors first. The tuple is empty if the object is valid and
        has no warnings.
    """
    options = options or ProgramOptions()
    declared = [
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

    def measure(probe: Probe) -> Iterator[Signal]:
        yield from _loose_shapes(probe)
        yield from _joints(probe)
        yield from overlap_signals(probe, options, allowances)

    return _check(spec, options, lines or {}, measure, declared)


def check_geometry(
    spec: ObjectSpec, options: ProgramOptions, lines: Mapping[str, int]
) -> tuple[Signal, ...]:
    """Run the compile checks on parts whose joints are not declared yet.

    Args:
        spec: the object, in which every part is fixed to the first part.
        options: thresholds.
        lines: line of the program that creates each part.
    """

    def measure(probe: Probe) -> Iterator[Signal]:
        # The joints, which are declared later, decide to which part a part is attached.
        yield from (s for s in _loose_shapes(probe) if s.code != "detached_part")
        yield from rest_overlap_signals(probe, options)

    return _check(spec, options, lines, measure)


def _check(
    spec: ObjectSpec,
    options: ProgramOptions,
    lines: Mapping[str, int],
    measure: Callable[[Probe], Iterable[Signal]],
    declared: Sequence[Signal] = (),
) -> tuple[Signal, ...]:
    """Return signals for sizes, masses and faces in one plane, `declared`, and measured signals.

    Measuring ends with an error if it exceeds the processor time `check_timeout_s`.
    """
    signals = [*plausibility(spec), *declared, *coplanar_faces(spec)]
    try:
        signals += measure(Probe(spec, options.check_timeout_s))
    except OutOfTime:
        message = "the object could not be checked in the time allowed"
        limit = {"value": options.check_timeout_s, "threshold": options.check_timeout_s}
        hint = "use fewer shapes, lathe sectors or parts that overlap"
        signals.append(error_signal("too_intricate", message, hint=hint, **limit))
    return deduplicated(_with_line(signal, lines) for signal in signals)


def _with_line(signal: Signal, lines: Mapping[str, int]) -> Signal:
    """Add the line that creates the signal's joint or part, unless the signal has a line."""
    key = f"joint:{signal.joint}" if signal.joint is not None else f"part:{signal.part}"
    if signal.line is None and key in lines:
        return signal.model_copy(update={"line": lines[key]})
    return signal


def _loose_shapes(probe: Probe) -> Iterator[Signal]:
    """Yield errors for shapes that touch neither the rest of their part nor the part's parent.

    If no shape of a part touches the parent, the error is that the part is detached.
    """
    reach = TOUCH_GAP_M + 1e-6
    joints = {joint.child: joint for joint in probe.spec.joints}
    for index, part in enumerate(probe.spec.parts):
        indices = probe.of_part(index)
        pieces = {geom: indices[probe.geom[indices] == geom] for geom in probe.geom[indices]}
        connected = DisjointSet(pieces)
        for a, b in itertools.combinations(pieces, 2):
            if not connected.connected(a, b) and probe.nearest(pieces[a], pieces[b], reach):
                connected.merge(a, b)
        components = sorted(sorted(component) for component in connected.subsets())
        attached = [False] * len(components)
        if part.name in joints:
            joint = joints[part.name]
            parent = probe.of_part(probe.names.index(joint.parent))
            for k, shapes in enumerate(components):
                component_pieces = np.concatenate([pieces[geom] for geom in shapes])
                attached[k] = probe.nearest(component_pieces, parent, reach) is not None
            if not any(attached):
                yield _detached(probe, indices, joint)
                attached[0] = True
        # The main component is the largest of those that touch the parent, or else the largest.
        # All other components must touch the parent.
        main = max(range(len(components)), key=lambda k: (attached[k], len(components[k])))
        for k, shapes in enumerate(components):
            if k != main and not attached[k]:
                names = [probe.geom_names[geom] for geom in shapes]
                verb = "touches" if len(names) == 1 else "touch"
                yield error_signal(
                    "loose_shape",
                    f"part {part.name!r}: {', '.join(names[:4])} {verb} nothing else of the part",
                    part=part.name,
                    threshold=TOUCH_GAP_M,
                    hint="move the shape until it touches, or add what holds it",
                )


def _detached(probe: Probe, pieces: NDArray, joint: JointSpec) -> Signal:
    """Return the error of a joint whose child does not touch its parent, with the gap [m]."""
    closest = probe.nearest(pieces, probe.of_part(probe.names.index(joint.parent)), 100.0)
    return error_signal(
        "detached_part",
        f"part {joint.child!r} does not touch {joint.parent!r}, which joint {joint.name!r} "
        "attaches it to",
        part=joint.child,
        value=None if closest is None else closest.distance,
        threshold=TOUCH_GAP_M,
        hint="close the gap, or attach the part to the one that it touches",
    )


def _joints(probe: Probe) -> Iterator[Signal]:
    """Check the axis, the range and the opening direction of every joint that is not fixed."""
    object_size = float(np.linalg.norm(probe.high.max(axis=0) - probe.low.min(axis=0)))
    for joint in probe.spec.joints:
        if joint.type != "fixed":
            low, high = probe.extent(probe.names.index(joint.child))
            size = float(np.linalg.norm(high - low))
            yield from _axis(joint, low, high, AXIS_SLACK * size)
            yield from _range(joint, size, object_size)
            yield from _opens(probe.spec, joint)


def _axis(joint: JointSpec, low: NDArray, high: NDArray, slack: float) -> Iterator[Signal]:
    """Check the distance [m] of a joint's axis or center from the bounding box of the child."""
    point = np.array(joint.pos)
    if joint.type == "ball":
        distance = float(np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0)))
        message = f"the ball lies beside part {joint.child!r}"
        hint = "put `at` where the ball sits, on the part that it turns"
    elif joint.type != "prismatic":
        distance = line_box_distance(point, np.array(joint.axis), low, high)
        message = f"the axis passes beside part {joint.child!r}"
        hint = "put `at` on the hinge: an edge or the middle of the part that turns"
    else:
        return
    if distance > slack:
        yield _joint_error(joint, "axis_off", message, hint, distance, slack)


def _range(joint: JointSpec, size: float, object_size: float) -> Iterator[Signal]:
    """Check the limits of a joint.

    Args:
        joint: the joint.
        size: diagonal of the child's bounding box [m].
        object_size: diagonal of the object's bounding box [m].
    """
    if joint.type == "continuous" or (joint.type == "ball" and joint.upper == 0.0):
        return
    width = joint.upper - joint.lower
    slides = joint.type == "prismatic"
    smallest = MIN_SLIDE * size if slides else MIN_TURN_RAD
    largest = MAX_SLIDE * object_size if slides else 2 * np.pi + 1e-6
    if width < smallest:
        hint = "give the range that the real thing has"
        yield _joint_error(joint, "range_small", "the range moves nothing", hint, width, smallest)
    if width > largest:
        hint = "shorten the range" if slides else "use continuous for what turns without end"
        extreme = max(abs(joint.lower), abs(joint.upper))
        if not slides and extreme > 3 * math.pi:
            hint = radians_hint(extreme)
        elif slides and extreme > 10 * largest:
            hint = f"lengths are in metres: {extreme:g} mm are {extreme / 1000:g}"
        yield _joint_error(joint, "range_large", "the range is too large", hint, width, largest)
    if not joint.lower - 1e-9 <= 0.0 <= joint.upper + 1e-9:
        nearest = joint.lower if joint.lower > 0 else joint.upper
        message = "the range leaves out 0, where the object is drawn"
        hint = "shapes are drawn at 0, so the range must hold 0"
        yield _joint_error(joint, "rest_outside", message, hint, 0.0, nearest)


def _opens(spec: ObjectSpec, joint: JointSpec) -> Iterator[Signal]:
    """Check that positive positions move the child in the direction that `opens` declares."""
    if joint.intent is None or joint.intent.opens is None:
        return
    cosine = opening_alignment(spec, joint)
    if cosine is None:
        message = "opens= names a way, but the middle of what it turns hardly moves"
        yield _joint_error(
            joint, "opens_no_way", message, "leave opens= out", 0.0, MIN_OPENING_COSINE
        )
    elif cosine < MIN_OPENING_COSINE:
        message = f"positive does not move {joint.child!r} the way that opens= names"
        hint = "turn the axis around, or put `at` on the opposite edge (positive opens)"
        yield _joint_error(joint, "opens_wrong_way", message, hint, cosine, MIN_OPENING_COSINE)


def _joint_error(
    joint: JointSpec, code: str, message: str, hint: str, value: float, threshold: float
) -> Signal:
    return error_signal(
        code,
        f"joint {joint.name!r}: {message}",
        joint=joint.name,
        part=joint.child,
        value=float(value),
        threshold=float(threshold),
        hint=hint,
    )

"""Stages of program synthesis: the programs that the programmer writes one after another.

With `one`, the programmer writes a whole program. With `three`, as in the paper, the programmer
first writes a geometry program, then an articulation program that continues the accepted geometry
program, and then an export program that continues both. The joined texts form one program.

After each stage, the object is compared with its parsed node and with that of the last program.
"""

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from ..checks.compile_checks import check_geometry
from ..checks.signals import Signal, deduplicated, error_signal
from ..config import ProgramOptions
from ..errors import NeoWorldError
from ..export import export_object, read_urdf
from ..export.object_of_mechanism import to_object
from ..spec import ObjectSpec, TreeNode, inertial
from ..spec.scale import fit_to_box
from .ask import join_texts
from .building import BuildResult, build, run

LEAST_MASS_RATIO = 0.99
"""Smallest allowed ratio of a part's masses before and after it is written to URDF and read back.

The ratio is the smaller mass over the larger mass.
"""


class Stage(NamedTuple):
    """One stage of program synthesis: a program that the programmer writes."""

    file: str
    """Name of the stage; its program is stored as <name>.py."""
    critics: tuple[str, ...]
    build: Callable[[str, ProgramOptions], BuildResult]
    """Builds and checks the joined texts of the stages up to this one."""


def build_geometry(text: str, options: ProgramOptions) -> BuildResult:
    """Build parts without joints, and check shapes, overlaps, sizes and masses."""
    built = run(text, options, without_joints=True)
    if built.spec is None:
        return built
    signals = check_geometry(built.spec, options, built.lines)
    return replace(built, signals=deduplicated((*built.signals, *signals)))


def build_export(text: str, options: ProgramOptions) -> BuildResult:
    """Build and check the whole object, and compare it with the object read back from its URDF."""
    built = build(text, options)
    if built.spec is None:
        return built
    _, signals = urdf_round_trip(built.spec)
    return replace(built, signals=deduplicated((*built.signals, *signals)))


STAGES: dict[Literal["one", "three"], tuple[Stage, ...]] = {
    "one": (Stage("program", ("geometry", "articulation"), build),),
    "three": (
        Stage("geometry", ("geometry",), build_geometry),
        Stage("articulation", ("articulation",), build),
        Stage("export", ("export",), build_export),
    ),
}
"""Stages by the value of `program.stages`."""
NOTHING_MOVES = "# The object is one part: nothing of it moves against anything.\n"
"""Articulation program of an object with one part, which needs no model."""


def needs_model(stage: Stage, spec: ObjectSpec, node: TreeNode) -> bool:
    """Return True if a model must write the stage's program.

    An object with one part and no parsed articulation needs no articulation program from a model.
    """
    return stage.file != "articulation" or len(spec.parts) > 1 or bool(node.articulation)


def urdf_round_trip(spec: ObjectSpec) -> tuple[ObjectSpec | None, list[Signal]]:
    """Write an object as URDF, and read it back.

    Returns:
        The object that was read, or None if reading failed, and an error for every difference in
        links, joints, limits or masses.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            export_object(spec, Path(folder))
            read = to_object(read_urdf(Path(folder) / "object.urdf")).spec
    except NeoWorldError as error:
        return None, [error_signal("export", f"the object's URDF cannot be read back: {error}")]
    signals = []
    masses = {part.name: inertial(read, part).mass for part in read.parts}
    for part in spec.parts:
        name = spec.name if part.name == spec.root else part.name
        mass = inertial(spec, part).mass
        if name not in masses:
            signals.append(error_signal("export", f"the URDF read back has no link {name!r}"))
        elif not LEAST_MASS_RATIO * mass <= masses[name] <= mass / LEAST_MASS_RATIO:
            message = f"link {name!r} weighs {masses[name]:.4g} kg in the URDF"
            signals.append(error_signal("export", message, value=masses[name], threshold=mass))
    joints = {joint.name: joint for joint in read.joints}
    # A ball joint becomes three hinges.
    for joint in (joint for joint in spec.joints if joint.type != "ball"):
        read_joint = joints.get(joint.name)
        if read_joint is None or read_joint.type != joint.type:
            message = f"the URDF read back has no {joint.type} joint {joint.name!r}"
            signals.append(error_signal("export", message))
        elif abs(read_joint.lower - joint.lower) + abs(read_joint.upper - joint.upper) > 1e-3:
            message = f"joint {joint.name!r} has other limits in the URDF"
            signals.append(
                error_signal("export", message, value=read_joint.upper, threshold=joint.upper)
            )
    return read, signals


def in_stage_lines(
    signals: tuple[Signal, ...], earlier_texts: Mapping[str, str]
) -> tuple[Signal, ...]:
    """Convert the line numbers of signals from the joined text to the text of the current stage.

    A signal in an accepted text of an earlier stage loses its line number, and its message mentions
    the earlier stages instead.
    """
    if not earlier_texts:
        return signals
    # `joined` adds one line with the name of the text that follows.
    skipped = join_texts({**earlier_texts, "": ""}).count("\n")
    converted = []
    for signal in signals:
        if signal.line is None:
            converted.append(signal)
        elif signal.line > skipped:
            converted.append(signal.model_copy(update={"line": signal.line - skipped}))
        else:
            message = (
                f"{signal.message} (made in the accepted {' or '.join(earlier_texts)} program)"
            )
            converted.append(signal.model_copy(update={"line": None, "message": message}))
    return tuple(converted)


PROPORTION_WARNING, PROPORTION_ERROR = 0.08, 0.25
"""Limits of an edge's relative deviation from the parsed edge, after the best uniform scaling."""
SIZE_WARNING, SIZE_ERROR = 0.15, 1.0
"""Limits of the relative deviation of the uniform scale from 1.

Composition scales the whole object, so a wrong size also makes the wall thickness wrong.
"""
_OF_SIZE = ("proportions", "wrong_size")


def compare_to_node(spec: ObjectSpec, node: TreeNode) -> Iterator[Signal]:
    """Yield a signal for each difference between an object and its parsed node.

    Proportions, size and the numbers of moving parts are compared.
    """
    # The parsed box includes parts that are open in the photo, so they are opened here, too.
    to_box = fit_to_box(spec, node)
    size, parsed_size, factor = to_box.high - to_box.low, np.array(node.box3d.size), to_box.factor
    edges = size * factor / parsed_size - 1
    axis = int(np.argmax(np.abs(edges)))
    if abs(edges[axis]) > PROPORTION_WARNING:
        shown, parsed = (" x ".join(f"{v:.3f}" for v in edges_m) for edges_m in (size, parsed_size))
        yield Signal(
            severity="error" if abs(edges[axis]) > PROPORTION_ERROR else "warning",
            code="proportions",
            message=f"the object{_open_parts(node)} measures {shown} m, "
            f"the box in the photo {parsed} m; {'xyz'[axis]} is too "
            f"{'large' if edges[axis] > 0 else 'small'} for the others",
            value=float(edges[axis]),
            threshold=PROPORTION_WARNING,
            hint="fill the given box in all three directions; is the front at +x?",
        )
    deviation = max(factor, 1 / factor) - 1
    if deviation > SIZE_WARNING:
        yield Signal(
            severity="error" if deviation > SIZE_ERROR else "warning",
            code="wrong_size",
            message=f"the object is {1 / factor:.3g} times as large as the box in the photo",
            value=1 / factor,
            threshold=1.0 + SIZE_WARNING,
            hint="write it at the given size, in metres",
        )
    counts = Counter(_motion(joint.type) for joint in spec.joints if joint.type != "fixed")
    for kind, count in Counter(_motion(part.type) for part in node.articulation).items():
        if counts[kind] < count:
            names = [part.part for part in node.articulation if _motion(part.type) == kind]
            yield error_signal(
                "missing_joint",
                f"the photo shows {count} {kind} parts ({', '.join(names)}), "
                f"the program has {counts[kind]}",
                value=counts[kind],
                threshold=count,
                hint="make each a part of that name, with its joint",
            )


def compare_geometry(spec: ObjectSpec, node: TreeNode) -> Iterator[Signal]:
    """Yield a signal for each difference between parts without joints and the parsed node.

    If parts are open in the photo, the box is not compared, because parts cannot open without
    joints.
    """
    has_open_parts = any(part.opening for part in node.articulation)
    skipped = ("missing_joint", *(_OF_SIZE if has_open_parts else ()))
    yield from (signal for signal in compare_to_node(spec, node) if signal.code not in skipped)
    if len(spec.parts) - 1 < len(node.articulation):
        names = ", ".join(part.part for part in node.articulation)
        yield error_signal(
            "missing_part",
            f"the photo shows moving parts ({names}), the program makes "
            f"{len(spec.parts)} part{'s' * (len(spec.parts) != 1)} in all",
            value=len(spec.parts),
            threshold=len(node.articulation) + 1,
            hint="make each moving part a part of that name, beside what it moves against",
        )


def _motion(joint_type: str) -> str:
    return "prismatic" if joint_type == "prismatic" else "turning"


def _open_parts(node: TreeNode) -> str:
    """List the parts that are open in the photo, for a message."""
    parts = [f"{part.part} {part.opening:.0%}" for part in node.articulation if part.opening > 0]
    return f", with {', '.join(parts)} open as in the photo," if parts else ""


def lost_parts(before: ObjectSpec, after: ObjectSpec, removed: Sequence[str]) -> Iterator[Signal]:
    """Yield an error if a revised program lacks parts or joints that `removed` does not mention.

    Numbers are compared as well as names, so a renamed part or joint is not an error.
    """
    groups = [("part", [p.name for p in before.parts], [p.name for p in after.parts])]
    for kind in ("revolute", "continuous", "prismatic"):
        old, new = (
            [joint.name for joint in spec.joints if joint.type == kind] for spec in (before, after)
        )
        groups.append((f"{kind} joint", old, new))
    mentioned = " ".join(removed)
    for kind, old, new in groups:
        missing = [name for name in old if name not in new]
        unexplained = [name for name in missing if name not in mentioned]
        if unexplained and len(old) - len(new) > len(missing) - len(unexplained):
            yield error_signal(
                "lost",
                f"the earlier program had {kind} {', '.join(unexplained)}, this one has not",
                value=len(new),
                threshold=len(old),
                hint="put it back, or name it in `removed` if it was wrong",
            )

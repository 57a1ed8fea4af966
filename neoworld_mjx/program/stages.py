"""Stages of program synthesis: the programs that the programmer writes one after another.

With `one`, the programmer writes a whole program. With `three`, as in the paper, the programmer
first writes a geometry program, then an articulation program that continues the accepted geometry
program, and then an export program that continues both. The joined texts form one program.
"""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

from ..checks.compile_checks import check_geometry
from ..checks.signals import Signal, deduplicated, error_signal
from ..config import ProgramOptions
from ..errors import NeoWorldError
from ..export import export_object, read_urdf
from ..export.importing import to_object
from ..spec import ObjectSpec, TreeNode, inertial
from .attempt import join_texts
from .sandbox import BuildResult, build, run

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
    for joint in spec.joints:
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

"""The programs that a programmer writes for an object, in order, and how each is built.

`one`: a whole program. `three`, the paper's: geometry; articulation, which goes on where the
accepted geometry ends; export, which goes on after that. Their texts joined are one program.
"""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

from ..checks.signals import Signal, deduplicated
from ..config import ProgramOptions
from ..errors import NeoWorldError
from ..export import export_object, import_urdf
from ..spec import ObjectSpec, TreeNode, inertial
from .attempt import joined
from .geometry_check import check_geometry
from .make import build
from .sandbox import Built, run

LEAST_MASS_RATIO = 0.99
"""Least ratio of a part's mass before and after the URDF."""


class Stage(NamedTuple):
    """One program that the programmer is asked for."""

    file: str
    """Its name, and that of its text without ".py"."""
    critics: tuple[str, ...]
    build: Callable[[str, ProgramOptions], Built]
    """Builds the texts up to and with this one, joined, and checks what they make."""


def build_geometry(text: str, options: ProgramOptions) -> Built:
    """Build parts without joints, each fastened to the first, and check shapes and room."""
    built = run(text, options, loose=True)
    if built.spec is None:
        return built
    findings = check_geometry(built.spec, options, built.lines)
    return replace(built, signals=deduplicated((*built.signals, *findings)))


def build_export(text: str, options: ProgramOptions) -> Built:
    """Build the whole object, write its URDF with meshes, read that back and compare."""
    built = build(text, options)
    if built.spec is None:
        return built
    _, findings = through_urdf(built.spec)
    return replace(built, signals=deduplicated((*built.signals, *findings)))


STAGES: dict[Literal["one", "three"], tuple[Stage, ...]] = {
    "one": (Stage("program", ("geometry", "articulation"), build),),
    "three": (
        Stage("geometry", ("geometry",), build_geometry),
        Stage("articulation", ("articulation",), build),
        Stage("export", ("export",), build_export),
    ),
}
"""By the value of `program.stages`."""
NOTHING_MOVES = "# The object is one part: nothing of it moves against anything.\n"
"""The articulation program of an object of one part, which no model is asked for."""


def needs_asking(stage: Stage, spec: ObjectSpec, node: TreeNode) -> bool:
    """Tell whether a stage's program is up to a model, given what the stages before made."""
    return stage.file != "articulation" or len(spec.parts) > 1 or bool(node.articulation)


def through_urdf(spec: ObjectSpec) -> tuple[ObjectSpec | None, list[Signal]]:
    """Write an object as URDF and read it back.

    Returns:
        The object as read, None if it could not be; and an error for every difference in links,
        joints, limits or masses.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            export_object(spec, Path(folder))
            read = import_urdf(Path(folder) / "object.urdf").spec
    except NeoWorldError as error:
        return None, [_differs(f"the object's URDF cannot be read back: {error}")]
    signals = []
    back = {part.name: inertial(read, part).mass for part in read.parts}
    for part in spec.parts:
        name = spec.name if part.name == spec.root else part.name
        mass = inertial(spec, part).mass
        if name not in back:
            signals.append(_differs(f"the URDF read back has no link {name!r}"))
        elif not LEAST_MASS_RATIO * mass <= back[name] <= mass / LEAST_MASS_RATIO:
            message = f"link {name!r} weighs {back[name]:.4g} kg in the URDF"
            signals.append(_differs(message, back[name], mass))
    return read, [*signals, *_joint_differences(spec, read)]


def _joint_differences(spec: ObjectSpec, read: ObjectSpec) -> list[Signal]:
    back = {joint.name: joint for joint in read.joints}
    signals = []
    for joint in spec.joints:
        other = back.get(joint.name)
        if other is None or other.type != joint.type:
            signals.append(_differs(f"the URDF read back has no {joint.type} joint {joint.name!r}"))
        elif abs(other.lower - joint.lower) + abs(other.upper - joint.upper) > 1e-3:
            message = f"joint {joint.name!r} has other limits in the URDF"
            signals.append(_differs(message, other.upper, joint.upper))
    return signals


def _differs(message: str, value: float | None = None, threshold: float | None = None) -> Signal:
    return Signal(
        severity="error", code="export", message=message, value=value, threshold=threshold
    )


def in_own_lines(signals: tuple[Signal, ...], before: Mapping[str, str]) -> tuple[Signal, ...]:
    """Return signals with the lines of a stage's own text in place of the joined texts'.

    A signal of a line in an accepted text loses its line and names that text instead.
    """
    if not before:
        return signals
    # One more line holds the name of the text that follows.
    skipped = joined({**before, "": ""}).count("\n")
    moved = []
    for signal in signals:
        if signal.line is None:
            moved.append(signal)
        elif signal.line > skipped:
            moved.append(signal.model_copy(update={"line": signal.line - skipped}))
        else:
            message = f"{signal.message} (made in the accepted {' or '.join(before)} program)"
            moved.append(signal.model_copy(update={"line": None, "message": message}))
    return tuple(moved)

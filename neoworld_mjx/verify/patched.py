"""Built programs with their patches: building, files of every format, and terminal lines."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..checks.signals import Signal
from ..config import ProgramOptions
from ..errors import ExportError, SpecError
from ..export import object_files
from ..io import read_untrusted_text
from ..io.files import write_inside
from ..program import BuildResult, build
from ..program.views import open_state
from ..render import render_object, to_png
from ..spec import ObjectSpec
from .patch import SUFFIX, Patch, apply, read_patch

MAX_PRINTED = 20
"""Number of lines of a program's output that a terminal shows."""


@dataclass(frozen=True)
class PatchedProgram:
    """The result of building a program and applying the program's patch."""

    text: str
    built: BuildResult
    patch: Patch | None = None
    """The patch; None if the program has no patch."""
    stale: tuple[str, ...] = ()
    """Parts, joints, geoms and materials that the patch edits but the object lacks."""


def build_patched(program: Path, options: ProgramOptions) -> PatchedProgram:
    """Build the program in a file, and apply the program's patch to the object.

    Args:
        program: the file.
        options: sandbox, limits and thresholds.

    Raises:
        SpecError: the program or patch cannot be read, or the patched object is invalid.
    """
    text = read_program(program)
    built = build(text, options)
    patch = read_patch(program)
    if patch is None or built.spec is None:
        return PatchedProgram(text, built, patch)
    spec, stale = apply(patch, built.spec)
    return PatchedProgram(text, replace(built, spec=spec), patch, stale)


def read_program(program: Path) -> str:
    """Return a program's text.

    Raises:
        SpecError: the file cannot be read or is not text.
    """
    return read_untrusted_text(program, SpecError)


def spec_files(spec: ObjectSpec) -> dict[str, bytes]:
    """Return the contents of an object's files by name: export formats, spec.json and pictures.

    render.png shows the object with all joints at zero. If any joint moves, opened.png shows the
    object with all joints open.
    """
    files = object_files(spec)
    files["spec.json"] = spec.to_json().encode()
    files["render.png"] = to_png(render_object(spec))
    state = open_state(spec)
    if state:
        files["opened.png"] = to_png(render_object(spec, state))
    return files


def write_built(program: PatchedProgram, out: Path) -> None:
    """Write a built object in every format, its pictures, its program and its patch into a folder.

    Raises:
        ExportError: a file cannot be written.
    """
    assert program.built.spec is not None
    files = spec_files(program.built.spec) | {"program.py": program.text.encode()}
    if program.patch is not None:
        files["program" + SUFFIX] = program.patch.to_json().encode()
    write_files(files, out)


def listings(printed: str, signals: Iterable[Signal], file: Path, text: str) -> list[str]:
    """Return lines for a terminal: a program's printed output and its signals."""
    lines = printed.splitlines()
    return [
        *(f"{file.name} printed: {line}" for line in lines[:MAX_PRINTED]),
        *([f"... and {len(lines) - MAX_PRINTED} more lines"] * (len(lines) > MAX_PRINTED)),
        *(signal.listing(str(file), text) for signal in signals),
    ]


def write_files(files: Mapping[str, bytes], out: Path) -> None:
    """Write files into a folder, each atomically.

    Raises:
        ExportError: a file cannot be written.
    """
    path = ""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            write_inside(out, path, content)
    except OSError as error:
        raise ExportError(f"cannot write {out / path}: {error.strerror}") from None

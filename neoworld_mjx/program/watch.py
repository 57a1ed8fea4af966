"""Files and pictures of a built program, written again whenever the program changes."""

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..checks.signals import Signal
from ..config import ProgramOptions
from ..errors import ExportError, SpecError
from ..export import object_files
from ..io.files import write_inside
from ..render import render_object, to_png
from ..spec import ObjectSpec
from .failed_picture import FAILED, failed_picture
from .sandbox import BuildResult
from .views import open_state

log = logging.getLogger(__name__)

MAX_PRINTED = 20
"""Number of lines of a program's output that are logged."""
POLL_S = 0.2
"""Interval between checks of a program's file for changes [s]."""


@dataclass(frozen=True)
class BuiltProgram:
    """The text of a program, and the result of building it."""

    text: str
    built: BuildResult
    other_files: Mapping[str, str] = field(default_factory=dict)
    """Contents of other files that belong to the program, by file name."""
    notes: tuple[str, ...] = ()
    """Further lines to log."""


Builder = Callable[[Path], BuiltProgram]
"""Function that reads and builds the program in a file."""


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


def write_built(program: BuiltProgram, out: Path) -> frozenset[str]:
    """Write a built object into a folder, and return the written paths relative to the folder.

    Raises:
        ExportError: a file cannot be written.
    """
    assert program.built.spec is not None
    files = spec_files(program.built.spec) | {"program.py": program.text.encode()}
    files |= {name: content.encode() for name, content in program.other_files.items()}
    write_files(files, out)
    return frozenset(files)


def write_failed(program: BuiltProgram, out: Path, options: ProgramOptions) -> Path | None:
    """Write the picture of an object that fails its checks, and return the picture's path.

    If the program builds no object, return None. Other files in the folder are unchanged.

    Raises:
        ExportError: the picture cannot be written.
    """
    spec = program.built.spec
    if spec is None:
        return None
    picture = failed_picture(spec, options, program.built.allowances)
    write_files({FAILED: picture}, out)
    return out / FAILED


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


def watch(
    program: Path,
    out: Path,
    build: Builder,
    inputs: tuple[Path, ...] = (),
    options: ProgramOptions | None = None,
) -> int:
    """Build a program now and after every change of its files, until Ctrl-C is pressed.

    Each build logs one line and the program's signals. If the program has errors, the only file
    written is failed.png, and only if there is an object. If the program's file is missing, no file
    is changed.

    Args:
        program: the program's file.
        out: folder for the files of the object.
        build: reads and builds the program.
        inputs: other files on which the result depends; they need not exist.
        options: thresholds for the picture of an object that fails its checks.

    Returns:
        The number of builds.
    """
    count, stamps = 0, ()
    written: frozenset[str] = frozenset()
    try:
        while True:
            current = _stamp(program), *map(_stamp, inputs)
            if current != stamps:
                stamps = current
                count += current[0] is not None
                written = _rebuild(program, out, build, count, written, options)
            time.sleep(POLL_S)
    except KeyboardInterrupt:
        return count


def _stamp(program: Path) -> tuple[int, int] | None:
    """Return the modification time [ns] and the size of a file, or None if the file is missing."""
    try:
        status = program.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def _rebuild(
    program: Path,
    out: Path,
    build: Builder,
    count: int,
    written: frozenset[str],
    options: ProgramOptions | None,
) -> frozenset[str]:
    """Build a program, write its files, log the outcome, and return the paths in the folder."""
    start = time.monotonic()
    try:
        result = build(program)
    except SpecError as error:
        log.warning(f"{error}; waiting")
        return written
    built = result.built
    if built.spec is None or not built.ok:
        outcome, new_files = "has errors; the other files are unchanged", written
        try:
            picture = write_failed(result, out, options or ProgramOptions())
            outcome += f"; {FAILED} shows it" if picture else ""
        except ExportError as error:
            outcome = str(error)
    else:
        try:
            new_files = write_built(result, out)
            outcome = f"{len(built.spec.parts)} parts, {len(built.spec.joints)} joints"
            for path in {*written, FAILED} - new_files:
                (out / path).unlink(missing_ok=True)
        except ExportError as error:
            outcome, new_files = str(error), written
    log.info(f"build {count} in {time.monotonic() - start:.2f} s: {outcome}")
    for line in (*listings(built.printed, built.signals, program, result.text), *result.notes):
        log.info(line)
    return new_files

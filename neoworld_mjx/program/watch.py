"""Write the files and pictures of a built program, again whenever its text changes."""

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..checks.signals import Signal
from ..config import ProgramOptions
from ..errors import ExportError, SpecError
from ..export import object_files
from ..render import render_object, to_png
from ..spec import ObjectSpec
from .failed_picture import FAILED, failed_picture
from .sandbox import BuildResult
from .views import opened_state

log = logging.getLogger(__name__)

MAX_PRINTED = 20
"""Lines of a program's own output that are shown."""
POLL_S = 0.2
"""Interval at which a watched program's file is checked for changes."""


@dataclass(frozen=True)
class BuiltProgram:
    """A program's text and the result of building it."""

    text: str
    built: BuildResult
    beside: Mapping[str, str] = field(default_factory=dict)
    """Further files that go with the program, by name."""
    notes: tuple[str, ...] = ()
    """Further lines to log."""


Builder = Callable[[Path], BuiltProgram]
"""Reads and builds the program in a file."""


def built_files(program: BuiltProgram) -> Mapping[str, bytes]:
    """Return the files of a built object: its formats, program, description and pictures."""
    spec = program.built.spec
    assert spec is not None
    files = spec_files(spec)
    files["program.py"] = program.text.encode()
    return files | {name: content.encode() for name, content in program.beside.items()}


def spec_files(spec: ObjectSpec) -> dict[str, bytes]:
    """Return the files of an object: its formats, description and pictures.

    render.png shows it at rest; opened.png, written if any joint moves, with all joints open.
    """
    files = object_files(spec)
    files["spec.json"] = spec.to_json().encode()
    files["render.png"] = to_png(render_object(spec))
    state = opened_state(spec)
    if state:
        files["opened.png"] = to_png(render_object(spec, state))
    return files


def write_built(program: BuiltProgram, out: Path) -> frozenset[str]:
    """Write a built object into a folder and return the paths written, relative to it.

    Raises:
        ExportError: a file cannot be written.
    """
    files = built_files(program)
    write_files(files, out)
    return frozenset(files)


def write_failed(program: BuiltProgram, out: Path, options: ProgramOptions) -> Path | None:
    """Write the picture of an object that fails its checks, and return its path.

    None where the program gave no object to draw. Other files of the folder stay.

    Raises:
        ExportError: it cannot be written.
    """
    spec = program.built.spec
    if spec is None:
        return None
    picture = failed_picture(spec, options, program.built.allowances)
    write_files({FAILED: picture}, out)
    return out / FAILED


def signal_lines(program: BuiltProgram, file: Path) -> list[str]:
    """Return what a program printed and its signals, as terminals show them."""
    return listings(program.built.printed, program.built.signals, file, program.text)


def listings(printed: str, signals: Iterable[Signal], file: Path, text: str) -> list[str]:
    """Return what a program printed and signals of it, as terminals show them.

    Args:
        printed: the program's own output.
        signals: what was found.
        file: the program.
        text: of the program, for its lines.
    """
    lines = printed.splitlines()
    return [
        *(f"{file.name} printed: {line}" for line in lines[:MAX_PRINTED]),
        *([f"... and {len(lines) - MAX_PRINTED} more lines"] * (len(lines) > MAX_PRINTED)),
        *(signal.listing(str(file), text) for signal in signals),
    ]


def write_files(files: Mapping[str, bytes], out: Path) -> None:
    """Write files into a folder, each whole or not at all.

    Raises:
        ExportError: a file cannot be written.
    """
    for path, content in files.items():
        part = out / f"{path}.part"
        try:
            part.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(content)
            # A reader gets the old file or the new one, never half of one.
            part.replace(out / path)
        except OSError as error:
            raise ExportError(f"cannot write {out / path}: {error.strerror}") from None


def watch(
    program: Path,
    out: Path,
    make: Builder,
    beside: tuple[Path, ...] = (),
    options: ProgramOptions | None = None,
) -> int:
    """Build a program now and after every change of its files, until interrupted.

    Logs one line for each build, then its signals. A program with errors replaces no file and adds
    failed.png, if there is anything to draw; the folder stays unchanged while the program's file is
    missing.

    Args:
        program: the file.
        out: folder to write into.
        make: reads and builds the program.
        beside: other files that the result depends on; they need not exist.
        options: thresholds, for the picture of an object that fails.

    Returns:
        The number of builds, after Ctrl-C.
    """
    count, stamps = 0, ()
    written: frozenset[str] = frozenset()
    try:
        while True:
            current = _stamp(program), *map(_stamp, beside)
            if current != stamps:
                stamps = current
                count += current[0] is not None
                written = _rebuild(program, out, make, count, written, options)
            time.sleep(POLL_S)
    except KeyboardInterrupt:
        return count


def _stamp(program: Path) -> tuple[int, int] | None:
    """Return a file's modification time [ns] and size, None if it is missing."""
    try:
        status = program.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def _rebuild(
    program: Path,
    out: Path,
    make: Builder,
    count: int,
    written: frozenset[str],
    options: ProgramOptions | None,
) -> frozenset[str]:
    """Build a program, write its files, log the outcome, and return the paths now in the folder."""
    start = time.monotonic()
    try:
        result = make(program)
    except SpecError as error:
        log.warning(f"{error}; waiting")
        return written
    built = result.built
    if built.spec is None or not built.ok:
        outcome, fresh = "has errors, the files stay as they were", written
        try:
            drawn = write_failed(result, out, options or ProgramOptions())
            outcome += f"; {FAILED} shows it" if drawn else ""
        except ExportError as error:
            outcome = str(error)
    else:
        try:
            fresh = write_built(result, out)
            outcome = f"{len(built.spec.parts)} parts, {len(built.spec.joints)} joints"
            for path in {*written, FAILED} - fresh:
                (out / path).unlink(missing_ok=True)
        except ExportError as error:
            outcome, fresh = str(error), written
    log.info(f"build {count} in {time.monotonic() - start:.2f} s: {outcome}")
    for line in (*signal_lines(result, program), *result.notes):
        log.info(line)
    return fresh

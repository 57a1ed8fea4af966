"""Write the files and pictures of a built program, again whenever its text changes."""

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import ExportError, SpecError
from ..export import object_files
from ..render import render_object, to_png
from .sandbox import Built
from .views import opened_state

log = logging.getLogger(__name__)

POLL_S = 0.2
"""Interval between looks at a watched program's file."""


@dataclass(frozen=True)
class BuiltProgram:
    """A program's text and the result of building it."""

    text: str
    built: Built
    beside: Mapping[str, str] = field(default_factory=dict)
    """Further files that go with the program, by name."""
    notes: tuple[str, ...] = ()
    """What else is to be said of it."""


Builder = Callable[[Path], BuiltProgram]
"""Reads and builds the program in a file."""


def built_files(made: BuiltProgram) -> Mapping[str, bytes]:
    """Return the files of a built object: its formats, program, description and pictures.

    render.png shows it at rest, opened.png, where joints move, with all of them opened.
    """
    spec = made.built.spec
    assert spec is not None
    files = {path: content.encode() for path, content in object_files(spec).items()}
    files["program.py"] = made.text.encode()
    files |= {name: content.encode() for name, content in made.beside.items()}
    files["spec.json"] = spec.to_json().encode()
    files["render.png"] = to_png(render_object(spec))
    state = opened_state(spec)
    if state:
        files["opened.png"] = to_png(render_object(spec, state))
    return files


def write_built(made: BuiltProgram, out: Path) -> frozenset[str]:
    """Write a built object into a folder and return the paths written, relative to it.

    Raises:
        ExportError: a file cannot be written.
    """
    files = built_files(made)
    for path, content in files.items():
        part = out / f"{path}.part"
        try:
            part.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(content)
            # Whoever looks on finds the old file or the new one.
            part.replace(out / path)
        except OSError as error:
            raise ExportError(f"cannot write {out / path}: {error.strerror}") from None
    return frozenset(files)


def watch(program: Path, out: Path, make: Builder, beside: tuple[Path, ...] = ()) -> int:
    """Build a program now and after every change of its files, until interrupted.

    Logs one line for each build and one for each signal. A program with errors replaces no file,
    and the folder stays unchanged while the program's file is missing.

    Args:
        program: the file.
        out: folder to write into.
        make: how it is built.
        beside: other files that what it makes depends on; they need not be there.

    Returns:
        How many times it was built, after Ctrl-C.
    """
    count, seen = 0, ()
    written: frozenset[str] = frozenset()
    try:
        while True:
            now = _stamp(program), *map(_stamp, beside)
            if now != seen:
                seen = now
                count += now[0] is not None
                written = _again(program, out, make, count, written)
            time.sleep(POLL_S)
    except KeyboardInterrupt:
        return count


def _stamp(program: Path) -> tuple[int, int] | None:
    try:
        found = program.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def _again(
    program: Path, out: Path, make: Builder, count: int, written: frozenset[str]
) -> frozenset[str]:
    start = time.monotonic()
    try:
        made = make(program)
    except SpecError as error:
        log.warning(f"{error}; waiting")
        return written
    built = made.built
    if built.spec is None or not built.ok:
        end, fresh = "has errors, the files stay as they were", written
    else:
        try:
            fresh = write_built(made, out)
            end = f"{len(built.spec.parts)} parts, {len(built.spec.joints)} joints"
            for path in written - fresh:
                (out / path).unlink(missing_ok=True)
        except ExportError as error:
            end, fresh = str(error), written
    log.info(f"build {count} in {time.monotonic() - start:.2f} s: {end}")
    for line in (*(signal.phrase() for signal in built.signals), *made.notes):
        log.info(f"  {line}")
    return fresh


__all__ = ["Builder", "BuiltProgram", "built_files", "watch", "write_built"]

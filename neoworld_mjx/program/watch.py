"""Write what a program makes, files and pictures, and do it again whenever its text changes."""

import logging
import time
from collections.abc import Mapping
from pathlib import Path

from ..config import ProgramOptions
from ..errors import ExportError
from ..export import object_files
from ..render import render_object, to_png
from .make import build
from .sandbox import Built
from .views import opened_state

log = logging.getLogger(__name__)

POLL_S = 0.2
"""How often a watched program's file is looked at."""


def built_files(built: Built, text: str) -> Mapping[str, bytes]:
    """Return the files of a built object: its formats, program, description and pictures.

    render.png shows it at rest, opened.png, where joints move, with all of them opened.
    """
    assert built.spec is not None
    files = {path: content.encode() for path, content in object_files(built.spec).items()}
    files["program.py"] = text.encode()
    files["spec.json"] = built.spec.to_json().encode()
    files["render.png"] = to_png(render_object(built.spec))
    state = opened_state(built.spec)
    if state:
        files["opened.png"] = to_png(render_object(built.spec, state))
    return files


def write_built(built: Built, text: str, out: Path) -> frozenset[str]:
    """Write a built object into a folder and return the paths written, relative to it.

    Raises:
        ExportError: a file cannot be written.
    """
    files = built_files(built, text)
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


def watch(program: Path, out: Path, options: ProgramOptions) -> int:
    """Build a program now and after every change of its file, until interrupted.

    Each time is told in one line of the log, and every signal in one of its own. What a program with
    errors would have replaced stays as it was; so does the folder while the file is away.

    Args:
        program: the file.
        out: folder to write into.
        options: sandbox, limits and thresholds.

    Returns:
        How many times it was built, after Ctrl-C.
    """
    count, seen = 0, None
    written: frozenset[str] = frozenset()
    try:
        while True:
            now = _stamp(program)
            if now != seen:
                seen = now
                count += now is not None
                written = _again(program, out, options, count, written)
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
    program: Path, out: Path, options: ProgramOptions, count: int, written: frozenset[str]
) -> frozenset[str]:
    start = time.monotonic()
    try:
        text = program.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        log.warning(f"{program}: cannot be read ({error}); waiting")
        return written
    built = build(text, options)
    if built.spec is None or not built.ok:
        end, fresh = "has errors, the files stay as they were", written
    else:
        try:
            fresh = write_built(built, text, out)
            end = f"{len(built.spec.parts)} parts, {len(built.spec.joints)} joints"
            for path in written - fresh:
                (out / path).unlink(missing_ok=True)
        except ExportError as error:
            end, fresh = str(error), written
    log.info(f"build {count} in {time.monotonic() - start:.2f} s: {end}")
    for signal in built.signals:
        log.info(f"  {signal.phrase()}")
    return fresh


__all__ = ["built_files", "watch", "write_built"]

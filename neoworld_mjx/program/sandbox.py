"""Execution of programs, and checks of the objects that they build.

Errors of a program are returned as signals. Programs call the SDK. The sandbox `monty`, the
default, runs a program in an isolated worker process. `cpython` runs a program in this process
without isolation; use it only for programs that you trust. Equal texts build byte-identical
objects. With `program.language: blender`, a program that imports bpy runs in Blender (`blender/`).
"""

import errno
import os
import re
import time
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module

from ..checks.allowance import Allowance
from ..checks.compile_checks import check
from ..checks.signals import Signal, deduplicated, error_signal, has_errors
from ..config import ProgramOptions
from ..errors import open_files_exhausted
from ..spec import ObjectSpec
from .assemble import assemble
from .blender.blender_availability import require_blender
from .blender.blender_objects import run_blender
from .in_process import run_in_process
from .monty_sandbox import WorkerStarved, run_sandboxed
from .session import Session

_BPY = re.compile(r"^[ \t]*(import|from)[ \t]+bpy\b", re.MULTILINE)


@dataclass(frozen=True)
class BuildResult:
    """Result of running a program."""

    spec: ObjectSpec | None
    """The object; None if the program failed."""
    signals: tuple[Signal, ...] = ()
    printed: str = ""
    lines: dict[str, int] = field(default_factory=dict)
    """Line that creates each part or joint, by "part:NAME" or "joint:NAME"."""
    allowances: tuple[Allowance, ...] = ()
    """Overlaps that the program declares."""
    seconds: float = 0.0
    """Wall time of running the program and checking the object [s]."""

    @property
    def ok(self) -> bool:
        """True if the program builds an object and no signal is an error."""
        return self.spec is not None and not has_errors(self.signals)


def build(text: str, options: ProgramOptions | None = None) -> BuildResult:
    """Run a program, and check the object that it builds.

    The result's `ok` is True if the object passes every check.

    Raises:
        ProgramError: the program needs Blender, which is not installed or cannot be confined.
    """
    options = options or ProgramOptions()
    result = run(text, options)
    if result.spec is None:
        return result
    start = time.monotonic()
    try:
        signals = check(result.spec, options, result.lines, result.allowances)
    except Exception as error:  # Report a check that raises as a signal.
        message = f"a check failed: {type(error).__name__}: {error}"[:500]
        signals = (error_signal("internal", message),)
    seconds = result.seconds + time.monotonic() - start
    return replace(result, signals=deduplicated((*result.signals, *signals)), seconds=seconds)


def run(
    text: str, options: ProgramOptions | None = None, *, without_joints: bool = False
) -> BuildResult:
    """Run a program and convert its object into an ObjectSpec, without the compile checks.

    Args:
        text: the program.
        options: the sandbox and its limits.
        without_joints: if True, the parts have no joints yet, and every part is fixed to the first
            part.

    Raises:
        ProgramError: the program needs Blender, which is not installed or cannot be confined.
    """
    options = options or ProgramOptions()
    _load_shapes()
    in_blender = options.language == "blender" and _BPY.search(text) is not None
    if in_blender:
        require_blender()
    start = time.monotonic()
    session = _session(options)
    printed, errors = "", _check_text(text, options)
    spec: ObjectSpec | None = None
    if not errors:
        try:
            if in_blender:
                printed, errors = run_blender(text, session, options)
            elif options.sandbox == "cpython":
                printed, errors = run_in_process(text, session, options)
            else:
                session, printed, errors = _run_in_worker(text, session, options)
            if not has_errors(errors):
                spec, structure = assemble(session.objects, without_joints=without_joints)
                errors = [*errors, *structure]
        except Exception as error:
            if open_files_exhausted(error):
                raise OSError(errno.EMFILE, os.strerror(errno.EMFILE)) from None
            message = f"{type(error).__name__}: {error}"[:500]
            hint = "this is a fault of the SDK, not of the program"
            errors = [error_signal("internal", message, hint=hint)]
    lines: dict[str, int] = {}
    for obj in session.objects[:1]:
        lines |= {f"part:{part.name}": part._line for part in obj._parts if part._line}
        lines |= {f"joint:{joint.name}": joint._line for joint in obj._joints if joint._line}
    return BuildResult(
        None if has_errors(errors) else spec,
        deduplicated((*errors, *session.warnings)),
        printed,
        lines,
        tuple(session.objects[0]._allowances) if session.objects else (),
        time.monotonic() - start,
    )


def _run_in_worker(
    text: str, session: Session, options: ProgramOptions
) -> tuple[Session, str, list[Signal]]:
    """Run a program in the Monty sandbox; if the first run exceeds the time limit, run it again."""
    limit_cpu_time = False
    try:
        printed, errors = run_sandboxed(text, session, options)
    except WorkerStarved:
        printed, errors, limit_cpu_time = "", [], True
    timed_out = session.exceeded is not None and session.exceeded.code == "timeout"
    # Virtual machines count pauses as time of a thread, so a single timeout is not conclusive.
    if limit_cpu_time or timed_out:
        session = _session(options)
        printed, errors = run_sandboxed(text, session, options, limit_cpu_time=limit_cpu_time)
    return session, printed, errors


def _session(options: ProgramOptions) -> Session:
    return Session(
        max_seconds=options.timeout_s,
        max_parts=options.max_parts,
        max_geoms=options.max_geoms,
        max_pieces=options.max_pieces,
    )


@cache
def _load_shapes() -> None:
    """Import the packages that shapes need, so that no program's time includes the import."""
    for name in ("scipy.spatial", "manifold3d"):
        import_module(name)


def _check_text(text: str, options: ProgramOptions) -> list[Signal]:
    """Return an error if the text cannot be run, and an empty list otherwise."""
    size, limit = len(text.encode("utf-8", "replace")), options.max_text_bytes
    if size > limit:
        message = "the program's text is too long"
        return [error_signal("too_long", message, value=size, threshold=limit)]
    if "\0" in text:
        return [error_signal("syntax", "the text holds a NUL character")]
    try:
        text.encode()
    except UnicodeEncodeError:
        return [error_signal("syntax", "the text is not valid Unicode")]
    if options.language == "sdk" and _BPY.search(text):
        message = "the program imports bpy: it is one for Blender, and program.language is sdk"
        hint = "call the SDK, or set program.language=blender"
        return [error_signal("import", message, hint=hint)]
    return []

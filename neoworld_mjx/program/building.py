"""Building an object: the run of its program, and the checks of what it builds.

Errors of a program are returned as signals. Programs call the SDK. A program runs in a worker
process whose processor time and address space the operating system limits. Equal texts build
byte-identical objects. With `program.language: blender`, a program that imports bpy runs in
Blender (`blender/`).
"""

import errno
import os
import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field, replace

from ..checks.compile_checks import check
from ..checks.signals import Allowance, Signal, deduplicated, error_signal, has_errors
from ..config import ProgramOptions
from ..errors import NeoWorldError, open_files_exhausted
from ..io.limited_worker import WorkerEndedError, WorkerFailedError, run_limited
from ..spec import ObjectSpec
from .assemble import assemble
from .blender.blender_objects import run_blender
from .blender.blender_process import require_blender
from .sandbox import (
    ENDLESS_HINT,
    WALL_FACTOR,
    limit_signal,
    limited_calls,
    run_sandboxed,
)
from .session import MAX_TEXT_BYTES, LimitExceeded, Session

_NEEDS = ("scipy.spatial", "manifold3d", "neoworld_mjx.program.sdk")
"""Modules that are imported before the worker starts, so that no program's time includes them."""
_SHAPES_MIB = 1024
"""Address space for the SDK's shapes, in addition to the program's memory [MiB]."""
_INTERNAL = "this is a fault of the SDK, not of the program"
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

    @property
    def ok(self) -> bool:
        """True if the program builds an object and no signal is an error."""
        return self.spec is not None and not has_errors(self.signals)

    @property
    def errors(self) -> str:
        """Return the errors as one line; empty if there are none."""
        phrases = [signal.phrase() for signal in self.signals if signal.severity == "error"]
        return "; ".join(phrases) or ("" if self.spec is not None else "it builds no object")


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
    try:
        signals = check(result.spec, options, result.lines, result.allowances)
    except Exception as error:  # Report a check that raises as a signal.
        message = f"a check failed: {type(error).__name__}: {error}"[:500]
        signals = (error_signal("internal", message),)
    return replace(result, signals=deduplicated((*result.signals, *signals)))


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
    errors = _check_text(text, options)
    if errors:
        return BuildResult(None, tuple(errors))
    if options.language == "blender" and _BPY.search(text) is not None:
        require_blender()
        return _result(run_blender, text, options, without_joints=without_joints)
    return _run_in_worker(text, options, without_joints=without_joints)


def _run_in_worker(text: str, options: ProgramOptions, *, without_joints: bool) -> BuildResult:
    """Run a program in a worker process whose time and memory the operating system limits."""
    try:
        return run_limited(
            _work,
            (text, options, without_joints),
            needs=_NEEDS,
            timeout_s=options.timeout_s,
            memory_mib=options.memory_mib + _SHAPES_MIB,
            wall_factor=WALL_FACTOR,
        )
    except WorkerEndedError as end:
        if end.reason == "time":
            message = f"building the shapes took over {options.timeout_s:g} s; use fewer"
            error = error_signal("timeout", message, hint=ENDLESS_HINT)
        else:
            message = f"the program's worker ended ({end.reason}, status {end.status})"
            code = "memory" if end.reason == "memory" else "crashed"
            error = error_signal(code, message, hint="use fewer or simpler shapes")
        return BuildResult(None, (error,))
    except WorkerFailedError as failure:  # Not the program's fault: `_work` catches those.
        raise NeoWorldError(f"no program can run on this machine: {failure}") from None


def _work(text: str, options: ProgramOptions, without_joints: bool) -> BuildResult:
    """Run a program in the worker."""
    return _result(run_sandboxed, text, options, without_joints=without_joints, limited=True)


def _result(
    language: Callable[[str, Session, ProgramOptions], tuple[str, list[Signal]]],
    text: str,
    options: ProgramOptions,
    *,
    without_joints: bool,
    limited: bool = False,
) -> BuildResult:
    """Run a program with a function for its language, and assemble its object."""
    session = Session()
    spec: ObjectSpec | None = None
    printed, errors = "", []
    try:
        with limited_calls(session, options.timeout_s) if limited else nullcontext():
            printed, errors = language(text, session, options)
            if not has_errors(errors):
                spec, structure = assemble(session.objects, without_joints=without_joints)
                errors = [*errors, *structure]
    except LimitExceeded as exceeded:
        errors = [limit_signal(exceeded, session)]
    except Exception as error:
        if open_files_exhausted(error):
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE)) from None
        message = f"{type(error).__name__}: {error}"[:500]
        errors = [error_signal("internal", message, hint=_INTERNAL)]
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
    )


def _check_text(text: str, options: ProgramOptions) -> list[Signal]:
    """Return an error if the text cannot be run, and an empty list otherwise."""
    size, limit = len(text.encode("utf-8", "replace")), MAX_TEXT_BYTES
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

"""Run a program's text and return an object or signals; nothing that a program does raises.

Programs call the SDK. `monty`, the default, runs them in a sandbox; `cpython` runs them in this
process, without any isolation, for your own programs only. The same text gives the same object, to
the byte. With `program.language: blender` a program that imports bpy runs in Blender (`blender/`).
"""

import re
import time
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module

from ..checks.allowance import Allowance
from ..checks.signals import Signal, deduplicated, has_errors
from ..config import ProgramOptions
from ..spec import ObjectSpec
from .assemble import assemble
from .blender.blender_availability import require_blender
from .blender.blender_objects import run_blender
from .in_process import run_in_process
from .monty_sandbox import Starved, run_sandboxed
from .session import Session

_BPY = re.compile(r"^[ \t]*(import|from)[ \t]+bpy\b", re.MULTILINE)


@dataclass(frozen=True)
class Built:
    """Result of running a program."""

    spec: ObjectSpec | None
    """The object; None where a signal is an error of the program."""
    signals: tuple[Signal, ...] = ()
    printed: str = ""
    lines: dict[str, int] = field(default_factory=dict)
    """The program's line of each part and joint, by "part:door" or "joint:hinge"."""
    allowances: tuple[Allowance, ...] = ()
    """Overlaps that the program declares."""
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether there is an object without errors."""
        return self.spec is not None and not has_errors(self.signals)


def run(text: str, options: ProgramOptions | None = None, *, loose: bool = False) -> Built:
    """Run a program and assemble its object.

    Args:
        text: the program.
        options: the sandbox and its limits.
        loose: whether parts have no joints yet; they are then fastened to the first.

    Raises:
        ProgramError: the program is for Blender, which is not installed or cannot be confined here.
    """
    options = options or ProgramOptions()
    _load_shapes()
    in_blender = options.language == "blender" and _BPY.search(text) is not None
    if in_blender:
        require_blender()
    start = time.monotonic()
    session = _session(options)
    printed, problems = "", _check_text(text, options)
    spec: ObjectSpec | None = None
    if not problems:
        try:
            if in_blender:
                printed, problems = run_blender(text, session, options)
            elif options.sandbox == "cpython":
                printed, problems = run_in_process(text, session, options)
            else:
                patient = False
                try:
                    printed, problems = run_sandboxed(text, session, options)
                except Starved:
                    patient = True
                # Virtual machines charge a thread for pauses, too: one slow run is no proof.
                if patient or _out_of_time(session):
                    session = _session(options)
                    printed, problems = run_sandboxed(text, session, options, patient=patient)
            if not has_errors(problems):
                spec, structure = assemble(session.objects, loose=loose)
                problems = [*problems, *structure]
        except Exception as error:  # Any failure becomes a signal here.
            problems = [
                Signal(
                    severity="error",
                    code="internal",
                    message=f"{type(error).__name__}: {error}"[:500],
                    hint="this is a fault of the SDK, not of the program",
                )
            ]
    lines: dict[str, int] = {}
    for obj in session.objects[:1]:
        lines |= {f"part:{part.name}": part._line for part in obj._parts if part._line}
        lines |= {f"joint:{joint.name}": joint._line for joint in obj._joints if joint._line}
    return Built(
        None if has_errors(problems) else spec,
        deduplicated((*problems, *session.warnings)),
        printed,
        lines,
        tuple(session.objects[0]._allowances) if session.objects else (),
        time.monotonic() - start,
    )


def _session(options: ProgramOptions) -> Session:
    return Session(
        max_seconds=options.timeout_s,
        max_parts=options.max_parts,
        max_geoms=options.max_geoms,
        max_pieces=options.max_pieces,
    )


def _out_of_time(session: Session) -> bool:
    """Return whether the program's shapes used up its processor time."""
    return session.exceeded is not None and session.exceeded.code == "timeout"


@cache
def _load_shapes() -> None:
    """Import the packages that shapes need, so that no program's time limit pays for it."""
    for name in ("scipy.spatial", "manifold3d"):
        import_module(name)


def _check_text(text: str, options: ProgramOptions) -> list[Signal]:
    """Return the error of a text that no sandbox can run."""
    size = len(text.encode("utf-8", "replace"))
    if size > options.max_text_bytes:
        return [
            Signal(
                severity="error",
                code="too_long",
                message="the program's text is too long",
                value=size,
                threshold=options.max_text_bytes,
            )
        ]
    if "\0" in text:
        return [Signal(severity="error", code="syntax", message="the text holds a NUL character")]
    try:
        text.encode()
    except UnicodeEncodeError:
        return [Signal(severity="error", code="syntax", message="the text is not valid Unicode")]
    if options.language == "sdk" and _BPY.search(text):
        message = "the program imports bpy: it is one for Blender, and program.language is sdk"
        hint = "call the SDK, or set program.language=blender"
        return [Signal(severity="error", code="import", message=message, hint=hint)]
    return []

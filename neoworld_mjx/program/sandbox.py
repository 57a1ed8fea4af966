"""Run a program's text and hand back an object or signals, never an exception.

`monty`, the default, runs the program in a sandbox; `cpython` runs it in this process, without any
isolation, for your own programs only. The same text gives the same object, to the byte.
"""

import time
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module

from ..config import ProgramOptions
from ..spec import ObjectSpec
from .allowance import Allowance
from .assemble import assemble
from .in_process import run_in_process
from .monty_sandbox import run_sandboxed
from .session import Session
from .signals import Signal, deduplicated, has_errors


@dataclass(frozen=True)
class Built:
    """Result of running a program."""

    spec: ObjectSpec | None
    """The object; None when any signal is an error of the program itself."""
    signals: tuple[Signal, ...] = ()
    printed: str = ""
    lines: dict[str, int] = field(default_factory=dict)
    """Where parts and joints were made: "part:door" or "joint:hinge" to a line."""
    allowances: tuple[Allowance, ...] = ()
    """Overlaps that the program declares."""
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether there is an object and no error was found."""
        return self.spec is not None and not has_errors(self.signals)


def run(text: str, options: ProgramOptions | None = None) -> Built:
    """Run a program and assemble its object.

    Args:
        text: the program.
        options: which sandbox, and its limits.
    """
    options = options or ProgramOptions()
    _load_shapes()
    start = time.monotonic()
    session = Session(
        max_seconds=options.timeout_s,
        max_parts=options.max_parts,
        max_geoms=options.max_geoms,
        max_pieces=options.max_pieces,
    )
    printed, problems = "", _unfit(text, options)
    spec: ObjectSpec | None = None
    if not problems:
        try:
            runner = run_sandboxed if options.sandbox == "monty" else run_in_process
            printed, problems = runner(text, session, options)
            if not problems:
                spec, problems = assemble(session.objects)
        except Exception as error:  # the border: whatever went wrong is a signal from here on
            problems = [
                Signal(
                    severity="error",
                    code="internal",
                    message=f"{type(error).__name__}: {error}"[:500],
                    hint="this is a fault of the SDK, not of the program",
                )
            ]
    lines: dict[str, int] = {}
    for item in session.objects[:1]:
        lines |= {f"part:{part.name}": part._line for part in item._parts if part._line}
        lines |= {f"joint:{joint.name}": joint._line for joint in item._joints if joint._line}
    return Built(
        None if has_errors(problems) else spec,
        deduplicated(problems),
        printed,
        lines,
        tuple(session.objects[0]._allowances) if session.objects else (),
        time.monotonic() - start,
    )


@cache
def _load_shapes() -> None:
    """Import what shapes are made with, so that this is on no program's account."""
    for name in ("scipy.spatial", "manifold3d"):
        import_module(name)


def _unfit(text: str, options: ProgramOptions) -> list[Signal]:
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
    return []

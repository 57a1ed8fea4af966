"""Conversion of exceptions that programs raise into error signals."""

from ..checks.signals import Signal, error_signal
from .session import LimitExceeded, Session

MODULE = "neoworld_mjx.program.sdk"
"""The only module of the package that a program may import."""

IMPORT_HINT = (
    f"import only from {MODULE}, math, random, itertools, functools, dataclasses and typing"
)
ENDLESS_HINT = "the program must end by itself; look for an endless loop"
_CLOSED_HINT = "programs have no files, network or processes"
_CODES: dict[type[BaseException], tuple[str, str]] = {
    TimeoutError: ("timeout", ENDLESS_HINT),
    MemoryError: ("memory", "the program holds too much at once"),
    RecursionError: ("recursion", "write a loop instead"),
    NotImplementedError: (
        "unsupported",
        "the sandbox knows a part of Python: no inheritance, no yield, no del, no properties, "
        "no import *",
    ),
    ImportError: ("import", IMPORT_HINT),
    OSError: ("forbidden", _CLOSED_HINT),
    ValueError: ("value", ""),
    TypeError: ("value", ""),
}


def exception_signal(
    error: BaseException, line: int | None = None, column: int | None = None
) -> Signal:
    """Return the error signal of an exception that a program raised."""
    code, hint = next(
        (entry for kind, entry in _CODES.items() if isinstance(error, kind)), ("runtime", "")
    )
    message = f"{type(error).__name__}: {error}"[:600]
    return error_signal(code, message, line=line, column=column, hint=hint)


def limit_signal(exceeded: LimitExceeded, session: Session) -> Signal:
    """Return the error signal of an exceeded limit."""
    hint = "use fewer or simpler shapes"
    return error_signal(exceeded.code, str(exceeded), line=session.line, hint=hint)

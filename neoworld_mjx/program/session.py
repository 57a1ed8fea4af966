"""Session of one run of a program: the objects, limits, resource counts and current line.

The SDK reads the current session from a context variable, so programs share no state.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

from ..checks.signals import Signal

MAX_WARNINGS = 20


class LimitExceeded(Exception):
    """Raised if a program exceeds a limit.

    The sandbox ends the program even if the program catches this exception.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass
class Session:
    """Objects, limits and resource counts of one run of a program."""

    max_parts: int = 300
    max_geoms: int = 3000
    max_pieces: int = 4000
    """Limit on the number of convex pieces of all shapes together."""
    filename: str | None = None
    """File name with which CPython compiles the program's text; None in the sandbox."""
    line: int | None = None
    """Current line of the program in the sandbox, counted from 1."""
    objects: list[Any] = field(default_factory=list)
    warnings: list[Signal] = field(default_factory=list)
    """Warnings of SDK calls, at most `MAX_WARNINGS`."""
    exceeded: LimitExceeded | None = None
    counts: dict[str, int] = field(default_factory=dict)

    def use(self, resource: str, amount: int, limit: int) -> None:
        """Add an amount to the count of a resource.

        Raises:
            LimitExceeded: the count exceeds the limit.
        """
        self.counts[resource] = self.counts.get(resource, 0) + amount
        if self.counts[resource] > limit:
            self.stop("too_big", f"the object needs over {limit} {resource}")

    def stop(self, code: str, message: str) -> None:
        """Raise LimitExceeded, and make every later SDK call raise it, too."""
        self.exceeded = self.exceeded or LimitExceeded(code, message)
        raise self.exceeded

    @contextmanager
    def call(self) -> Iterator[None]:
        """Make this session current during one SDK call.

        Raises:
            LimitExceeded: an earlier call exceeded a limit.
        """
        if self.exceeded is not None:
            raise self.exceeded
        with use_session(self):
            yield


_current: ContextVar[Session | None] = ContextVar("program_session", default=None)


def current() -> Session:
    """Return the current session, or a new one with default limits."""
    return _current.get() or Session()


@contextmanager
def use_session(session: Session) -> Iterator[None]:
    """Make a session the current session in the block."""
    token = _current.set(session)
    try:
        yield
    finally:
        _current.reset(token)


def warn(code: str, message: str, hint: str) -> None:
    """Add a warning about the current call to the current session, if there is one."""
    session = _current.get()
    if session is not None and len(session.warnings) < MAX_WARNINGS:
        line = current_line()
        warning = Signal(severity="warning", code=code, message=message, line=line, hint=hint)
        session.warnings.append(warning)


def current_line() -> int | None:
    """Return the program's current line, counted from 1, or None if it is unknown."""
    session = _current.get()
    if session is None:
        return None
    if session.filename is None:
        return session.line
    frame = sys._getframe(1)
    while frame is not None and frame.f_code.co_filename != session.filename:
        frame = frame.f_back
    return None if frame is None else frame.f_lineno

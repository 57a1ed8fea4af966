"""One run of a program: what it made so far, what it may still use, and the line it is at.

The SDK finds its session through a context variable, so two programs that run at once, or one after
the other, share nothing. Outside a session, when a person runs a program's file with Python, the
SDK works all the same and keeps no account.
"""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any


class LimitExceeded(Exception):
    """A program has used up a limit; a sandbox ends it, whatever the program catches.

    Args:
        code: the signal's code.
        message: what was used up.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass
class Session:
    """The account of one run."""

    max_seconds: float = float("inf")
    """Of the SDK's own work, in processor time [s]."""
    max_parts: int = 300
    max_geoms: int = 3000
    max_pieces: int = 4000
    """Convex pieces of all shapes together."""
    filename: str | None = None
    """Under which CPython runs the program's text."""
    line: int | None = None
    """Where the program is, as the sandbox tells it."""
    objects: list[Any] = field(default_factory=list)
    seconds: float = 0.0
    exceeded: LimitExceeded | None = None
    counts: dict[str, int] = field(default_factory=dict)

    def use(self, what: str, amount: int, limit: int) -> None:
        """Count something made and stop the program when it is too many.

        Raises:
            LimitExceeded: the limit is passed.
        """
        self.counts[what] = self.counts.get(what, 0) + amount
        if self.counts[what] > limit:
            self.stop("too_big", f"the object needs over {limit} {what}")

    def stop(self, code: str, message: str) -> None:
        """End the program here and at every later call."""
        self.exceeded = self.exceeded or LimitExceeded(code, message)
        raise self.exceeded

    @contextmanager
    def call(self) -> Iterator[None]:
        """Run one call of the SDK on this account.

        Raises:
            LimitExceeded: a limit was passed, now or before.
        """
        if self.exceeded is not None:
            raise self.exceeded
        # The work of this thread alone: a program must not fail because the machine is busy.
        start = time.thread_time()
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)
            self.seconds += time.thread_time() - start
        if self.seconds > self.max_seconds:
            self.stop("timeout", f"building the shapes took over {self.max_seconds:g} s; use fewer")


_current: ContextVar[Session | None] = ContextVar("program_session", default=None)


def current() -> Session:
    """Return the session that runs now, or one without account."""
    return _current.get() or Session()


def running() -> Session | None:
    """Return the session that runs now, if any."""
    return _current.get()


@contextmanager
def entered(session: Session) -> Iterator[None]:
    """Builder a session the current one for a whole program."""
    token = _current.set(session)
    try:
        yield
    finally:
        _current.reset(token)


def here() -> int | None:
    """Return the line of the program that is being run, if it is known."""
    session = _current.get()
    if session is None:
        return None
    if session.filename is None:
        return session.line
    frame = sys._getframe(1)
    while frame is not None and frame.f_code.co_filename != session.filename:
        frame = frame.f_back
    return None if frame is None else frame.f_lineno

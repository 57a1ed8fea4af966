"""Session of one run of a program: the objects, limits, resource counts and current line.

The SDK reads the current session from a context variable, so programs share no state.

A sandboxed program may pass values of any type: a string instead of a number, or a list with a
million entries. Every value is validated here before a spec is built from it. Each function returns
a valid value, and raises TypeError or ValueError for an invalid value. Every message mentions the
argument.
"""

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ..checks.signals import Signal, radians_hint
from ..io.names import is_name
from ..io.text_files import validation_message

MAX_WARNINGS = 20
MAX_TEXT_BYTES = 200_000
"""Limit on the length of a program's source."""


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
    line: int | None = None
    """Current line of the program, counted from 1; None if it is unknown."""
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
    return None if session is None else session.line


MAX_COORDINATE_M = 100.0
MIN_LENGTH_M = 1e-5
MAX_ROTATION_RAD = 4 * math.pi
"""Angle above which a whole number is rejected, because it is probably in degrees [rad]."""
_S = TypeVar("_S", bound=BaseModel)


def formatted(value: Any, depth: int = 2) -> str:
    """Format a value for a message; long strings, containers and integers are shortened.

    Containers are formatted only to `depth` levels, because the full text of a list that a program
    nests repeatedly in itself could exceed the memory.
    """
    if isinstance(value, list | tuple) and (len(value) > 6 or not depth):
        return f"{type(value).__name__} of {len(value)} items"
    if isinstance(value, int) and value.bit_length() > 100:
        return f"an integer of {value.bit_length()} bits"
    if isinstance(value, str):
        return repr(value if len(value) <= 60 else value[:57] + "...")
    if isinstance(value, bool | int | float) or value is None:
        return repr(value)
    if isinstance(value, list | tuple):
        inside = ", ".join(formatted(item, depth - 1) for item in value)
        return f"[{inside}]" if isinstance(value, list) else f"({inside})"
    return type(value).__name__


def number(value: Any, argument: str, limit: float = 1e6) -> float:
    """Return a finite number whose magnitude is at most `limit`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{argument} must be a number, got {formatted(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{argument} must be finite, got {value!r}")
    if abs(value) > limit:
        raise ValueError(f"{argument} must lie within +-{limit:g}, got {formatted(value)}")
    return float(value)


def length(value: Any, argument: str) -> float:
    """Return a positive length [m]."""
    metres = number(value, argument, MAX_COORDINATE_M)
    if metres < MIN_LENGTH_M:
        raise ValueError(
            f"{argument} must be a positive length in metres, at least {MIN_LENGTH_M:g}, "
            f"got {metres!r}"
        )
    return metres


def sequence(value: Any, argument: str, minimum: int, maximum: int) -> Sequence[Any]:
    """Return a list or tuple with `minimum` to `maximum` entries."""
    if not isinstance(value, list | tuple):
        raise TypeError(f"{argument} must be a list or tuple, got {formatted(value)}")
    if not minimum <= len(value) <= maximum:
        span = str(minimum) if minimum == maximum else f"{minimum} to {maximum}"
        raise ValueError(f"{argument} must have {span} entries, got {len(value)}")
    return value


def pair(value: Any, argument: str, limit: float = MAX_COORDINATE_M) -> tuple[float, float]:
    """Return two finite numbers whose magnitudes are at most `limit`."""
    a, b = sequence(value, argument, 2, 2)
    return number(a, argument, limit), number(b, argument, limit)


def vector(
    value: Any, argument: str, limit: float = MAX_COORDINATE_M
) -> tuple[float, float, float]:
    """Return three finite numbers whose magnitudes are at most `limit`."""
    x, y, z = sequence(value, argument, 3, 3)
    return number(x, argument, limit), number(y, argument, limit), number(z, argument, limit)


def lengths(value: Any, argument: str) -> tuple[float, float, float]:
    """Return three positive lengths [m]."""
    x, y, z = sequence(value, argument, 3, 3)
    return length(x, argument), length(y, argument), length(z, argument)


def rotation(value: Any, argument: str) -> tuple[float, float, float]:
    """Return three angles [rad]; reject large whole numbers, which are probably in degrees."""
    angles = vector(value, argument, 200.0)
    largest = max(angles, key=abs)
    if abs(largest) > MAX_ROTATION_RAD and largest == round(largest):
        raise ValueError(f"{argument}: {radians_hint(largest)}")
    warn_of_degrees(largest, argument)
    return angles


def warn_of_degrees(angle: float, argument: str) -> None:
    """Warn if an angle is a whole number above pi, which is probably in degrees."""
    if abs(angle) > math.pi and angle == round(angle):
        message = f"{argument}: {angle:g} radians are {math.degrees(angle):.0f} degrees"
        hint = f"if {angle:g} degrees are meant, write math.radians({angle:g})"
        warn("degrees", message, hint)


def points(
    value: Any, argument: str, minimum: int, maximum: int
) -> tuple[tuple[float, float], ...]:
    """Return `minimum` to `maximum` points (a, b) [m]."""
    items = sequence(value, argument, minimum, maximum)
    return tuple(pair(item, f"{argument}[{i}]") for i, item in enumerate(items))


def integer(value: Any, argument: str, minimum: int, maximum: int) -> int:
    """Return an integer from `minimum` to `maximum`."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{argument} must be an integer, got {formatted(value)}")
    if not minimum <= value <= maximum:
        raise ValueError(
            f"{argument} must lie between {minimum} and {maximum}, got {formatted(value)}"
        )
    return value


def name(value: Any, argument: str) -> str:
    """Return an identifier with at most 48 letters, digits and underscores."""
    if not isinstance(value, str):
        raise TypeError(f"{argument} must be a string, got {formatted(value)}")
    if not is_name(value):
        raise ValueError(
            f"{argument} must start with a letter and hold only letters, digits and _ "
            f"(at most 48), got {formatted(value)}"
        )
    return value


def unused(value: str, kind: str, names: Sequence[str]) -> None:
    """Raise ValueError if a name, ignoring its case, is in `names`."""
    if twice := [name for name in names if name.lower() == value.lower()]:
        raise ValueError(f"{kind} {twice[0]!r} exists already")


def text(value: Any, argument: str, maximum: int = 200) -> str:
    """Return a string that is one printable line of at most `maximum` characters."""
    if not isinstance(value, str):
        raise TypeError(f"{argument} must be a string, got {formatted(value)}")
    if len(value) > maximum or not value.isprintable():
        raise ValueError(f"{argument} must be one line of at most {maximum} characters")
    return value


def colour(value: Any, argument: str) -> tuple[float, float, float]:
    """Return red, green and blue, each from 0 to 1."""
    r, g, b = vector(value, argument)
    if not all(0 <= v <= 1 for v in (r, g, b)):
        raise ValueError(
            f"{argument} must be red, green, blue between 0 and 1, got {formatted(value)}"
        )
    return r, g, b


def build_spec(model: type[_S], argument: str, **fields: Any) -> _S:
    """Build a spec from validated values.

    Raises:
        ValueError: the validation of the spec fails. The message is one line.
    """
    try:
        return model(**fields)
    except ValidationError as error:
        message = re.sub(r"\(root\): |Value error, ", "", validation_message(error, model))
        message = re.sub(r", got \{.*$", "", message, flags=re.DOTALL)
        raise ValueError(f"{argument}: {message}") from None

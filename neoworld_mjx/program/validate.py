"""Validate the arguments that programs pass to the SDK; every message names the argument.

A sandboxed program passes values of unknown type: a number may be a string, a list may hold a
million entries. Nothing reaches a description without being validated here. Each function returns
the valid value, and raises TypeError or ValueError for any other.
"""

import math
import re
from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ..checks.signals import in_radians
from ..io.names import is_name
from ..io.validation_message import validation_message
from .session import warn

MAX_COORDINATE_M = 100.0
MIN_LENGTH_M = 1e-5
_S = TypeVar("_S", bound=BaseModel)


def shown(value: Any, depth: int = 2) -> str:
    """Write a value for a message; long strings, containers and integers are shortened.

    Args:
        value: anything.
        depth: containers within containers that are written out. A program may put one list into
            many, which written out would be longer than any memory.
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
        inside = ", ".join(shown(item, depth - 1) for item in value)
        return f"[{inside}]" if isinstance(value, list) else f"({inside})"
    return type(value).__name__


def number(value: Any, argument: str, limit: float = 1e6) -> float:
    """Return a finite number of magnitude up to `limit`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{argument} must be a number, got {shown(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{argument} must be finite, got {value!r}")
    if abs(value) > limit:
        raise ValueError(f"{argument} must lie within +-{limit:g}, got {shown(value)}")
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


def sequence(value: Any, argument: str, least: int, most: int) -> Sequence[Any]:
    """Return a list or tuple with `least` to `most` entries."""
    if not isinstance(value, list | tuple):
        raise TypeError(f"{argument} must be a list or tuple, got {shown(value)}")
    if not least <= len(value) <= most:
        span = str(least) if least == most else f"{least} to {most}"
        raise ValueError(f"{argument} must have {span} entries, got {len(value)}")
    return value


def vector(
    value: Any, argument: str, limit: float = MAX_COORDINATE_M
) -> tuple[float, float, float]:
    """Return three finite numbers of magnitude up to `limit`."""
    x, y, z = sequence(value, argument, 3, 3)
    return number(x, argument, limit), number(y, argument, limit), number(z, argument, limit)


def lengths(value: Any, argument: str) -> tuple[float, float, float]:
    """Return three positive lengths [m]."""
    x, y, z = sequence(value, argument, 3, 3)
    return length(x, argument), length(y, argument), length(z, argument)


MOST_TURN_RAD = 4 * math.pi
"""Angle beyond which a turn is taken for one in degrees."""


def turn(value: Any, argument: str) -> tuple[float, float, float]:
    """Return three angles [rad]; whole numbers that can only be degrees are refused.

    A whole number beyond half a turn is rarely meant in radians, so it gives a warning.
    """
    angles = vector(value, argument, 200.0)
    largest = max(angles, key=abs)
    if abs(largest) > MOST_TURN_RAD and largest == round(largest):
        raise ValueError(f"{argument}: {in_radians(largest)}")
    doubt_radians(largest, argument)
    return angles


def doubt_radians(angle: float, argument: str) -> None:
    """Warn of a whole number of radians beyond half a turn, which looks like degrees."""
    if abs(angle) > math.pi and angle == round(angle):
        turned = f"{argument}: {angle:g} radians are {math.degrees(angle):.0f} degrees"
        hint = f"if {angle:g} degrees are meant, write math.radians({angle:g})"
        warn("degrees", turned, hint)


def points(value: Any, argument: str, least: int, most: int) -> tuple[tuple[float, float], ...]:
    """Return `least` to `most` points (a, b) [m]."""
    pairs = []
    for i, item in enumerate(sequence(value, argument, least, most)):
        a, b = sequence(item, f"{argument}[{i}]", 2, 2)
        pairs.append(
            (
                number(a, f"{argument}[{i}]", MAX_COORDINATE_M),
                number(b, f"{argument}[{i}]", MAX_COORDINATE_M),
            )
        )
    return tuple(pairs)


def whole(value: Any, argument: str, least: int, most: int) -> int:
    """Return an integer from `least` to `most`."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{argument} must be an integer, got {shown(value)}")
    if not least <= value <= most:
        raise ValueError(f"{argument} must lie between {least} and {most}, got {shown(value)}")
    return value


def name(value: Any, argument: str) -> str:
    """Return an identifier of at most 48 letters, digits and underscores."""
    if not isinstance(value, str):
        raise TypeError(f"{argument} must be a string, got {shown(value)}")
    if not is_name(value):
        raise ValueError(
            f"{argument} must start with a letter and hold only letters, digits and _ "
            f"(at most 48), got {shown(value)}"
        )
    return value


def text(value: Any, argument: str, most: int = 200) -> str:
    """Return one printable line of at most `most` characters."""
    if not isinstance(value, str):
        raise TypeError(f"{argument} must be a string, got {shown(value)}")
    if len(value) > most or not value.isprintable():
        raise ValueError(f"{argument} must be one line of at most {most} characters")
    return value


def colour(value: Any, argument: str) -> tuple[float, float, float]:
    """Return red, green and blue from 0 to 1."""
    r, g, b = vector(value, argument)
    if not all(0 <= v <= 1 for v in (r, g, b)):
        raise ValueError(f"{argument} must be red, green, blue between 0 and 1, got {shown(value)}")
    return r, g, b


def described(model: type[_S], argument: str, **fields: Any) -> _S:
    """Build a description from validated values.

    Raises:
        ValueError: the description refuses them; the message is one line.
    """
    try:
        return model(**fields)
    except ValidationError as error:
        message = (
            validation_message(error, model).replace("(root): ", "").replace("Value error, ", "")
        )
        message = re.sub(r", got \{.*$", "", message, flags=re.DOTALL)
        raise ValueError(f"{argument}: {message}") from None

"""Validate the arguments that programs pass to the SDK; every message names the argument.

A sandboxed program passes values of unknown type: a number may be a string, a list may hold a
million entries. Nothing reaches a description without being validated here.
"""

import math
import re
from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ..config import describe

MAX_COORDINATE_M = 100.0
MIN_LENGTH_M = 1e-5
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,47}")
_S = TypeVar("_S", bound=BaseModel)


def shown(value: Any) -> str:
    """Write a value for a message, shortened; big containers and numbers are not written out."""
    if isinstance(value, list | tuple) and len(value) > 6:
        return f"{type(value).__name__} of {len(value)} items"
    if isinstance(value, int) and value.bit_length() > 100:
        return f"an integer of {value.bit_length()} bits"
    if isinstance(value, str):
        return repr(value if len(value) <= 60 else value[:57] + "...")
    if isinstance(value, bool | int | float) or value is None:
        return repr(value)
    if isinstance(value, list | tuple):
        inside = ", ".join(shown(item) for item in value)
        return f"[{inside}]" if isinstance(value, list) else f"({inside})"
    return type(value).__name__


def number(value: Any, what: str, limit: float = 1e6) -> float:
    """Take a finite number of magnitude up to `limit`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{what} must be a number, got {shown(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{what} must be finite, got {value!r}")
    if abs(value) > limit:
        raise ValueError(f"{what} must lie within +-{limit:g}, got {shown(value)}")
    return float(value)


def length(value: Any, what: str) -> float:
    """Take a positive length in metres."""
    metres = number(value, what, MAX_COORDINATE_M)
    if metres < MIN_LENGTH_M:
        raise ValueError(
            f"{what} must be a positive length in metres, at least {MIN_LENGTH_M:g}, got {metres!r}"
        )
    return metres


def sequence(value: Any, what: str, least: int, most: int) -> Sequence[Any]:
    """Take a list or tuple of a bounded length."""
    if not isinstance(value, list | tuple):
        raise TypeError(f"{what} must be a list or tuple, got {shown(value)}")
    if not least <= len(value) <= most:
        span = str(least) if least == most else f"{least} to {most}"
        raise ValueError(f"{what} must have {span} entries, got {len(value)}")
    return value


def vector(value: Any, what: str, limit: float = MAX_COORDINATE_M) -> tuple[float, float, float]:
    """Take three numbers."""
    x, y, z = sequence(value, what, 3, 3)
    return number(x, what, limit), number(y, what, limit), number(z, what, limit)


def lengths(value: Any, what: str) -> tuple[float, float, float]:
    """Take three positive lengths in metres."""
    x, y, z = sequence(value, what, 3, 3)
    return length(x, what), length(y, what), length(z, what)


def points(value: Any, what: str, least: int, most: int) -> tuple[tuple[float, float], ...]:
    """Take a list of (a, b) points in metres."""
    found = []
    for i, item in enumerate(sequence(value, what, least, most)):
        a, b = sequence(item, f"{what}[{i}]", 2, 2)
        found.append(
            (
                number(a, f"{what}[{i}]", MAX_COORDINATE_M),
                number(b, f"{what}[{i}]", MAX_COORDINATE_M),
            )
        )
    return tuple(found)


def whole(value: Any, what: str, least: int, most: int) -> int:
    """Take an integer within bounds."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{what} must be an integer, got {shown(value)}")
    if not least <= value <= most:
        raise ValueError(f"{what} must lie between {least} and {most}, got {shown(value)}")
    return value


def name(value: Any, what: str) -> str:
    """Take an identifier."""
    if not isinstance(value, str):
        raise TypeError(f"{what} must be a string, got {shown(value)}")
    if not _NAME.fullmatch(value):
        raise ValueError(
            f"{what} must start with a letter and hold only letters, digits and _ (at most 48), "
            f"got {shown(value)}"
        )
    return value


def text(value: Any, what: str, most: int = 200) -> str:
    """Take a short line of text."""
    if not isinstance(value, str):
        raise TypeError(f"{what} must be a string, got {shown(value)}")
    if len(value) > most or not value.isprintable():
        raise ValueError(f"{what} must be one line of at most {most} characters")
    return value


def colour(value: Any, what: str) -> tuple[float, float, float]:
    """Take red, green, blue in 0 to 1."""
    r, g, b = vector(value, what)
    if not all(0 <= v <= 1 for v in (r, g, b)):
        raise ValueError(f"{what} must be red, green, blue between 0 and 1, got {shown(value)}")
    return r, g, b


def described(model: type[_S], what: str, **fields: Any) -> _S:
    """Build a description from checked values and phrase its own complaints in one line."""
    try:
        return model(**fields)
    except ValidationError as error:
        message = describe(error, model).replace("(root): ", "").replace("Value error, ", "")
        message = re.sub(r", got \{.*$", "", message, flags=re.DOTALL)
        raise ValueError(f"{what}: {message}") from None

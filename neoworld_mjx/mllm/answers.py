"""From a model's text to a validated value: find the JSON, check it, and phrase what is wrong."""

import json
import re
from collections.abc import Iterator
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ..config import describe

T = TypeVar("T", bound=BaseModel)

_FENCE = re.compile(r"```[A-Za-z0-9_-]*[ \t]*\r?\n(.*?)```", re.DOTALL)
_REASON_CHARS = 2000


class InvalidAnswer(Exception):
    """A text holds no JSON object, or one that breaks the schema; the message says what to mend."""


def read_answer(text: str, schema: type[T]) -> T:
    """Validate the JSON object in a model's text.

    The text may be bare JSON, JSON in a fenced block, or JSON with prose around it. Of several
    objects the first that validates counts, bare text first, then fences, then the largest.

    Raises:
        InvalidAnswer: nothing validates; the message speaks of the most likely object.
    """
    reason = ""
    for value in _objects(text):
        try:
            # Through JSON again, as only then lists may become tuples and strings enums.
            return schema.model_validate_json(json.dumps(value))
        except ValidationError as error:
            reason = reason or _shorten(describe(error, schema))
    raise InvalidAnswer(reason or _no_object(text))


def is_json(text: str) -> bool:
    """Tell whether a text as a whole is one JSON value, so that nothing of it is still missing."""
    try:
        _loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _objects(text: str) -> Iterator[dict[str, Any]]:
    """Yield the JSON objects in a text, the likeliest first."""
    for part in (text, *_FENCE.findall(text)):
        try:
            value = _loads(part)
        except (ValueError, RecursionError):
            continue
        if isinstance(value, dict):
            yield value
    yield from _embedded(text)


def _embedded(text: str) -> list[dict[str, Any]]:
    decoder = json.JSONDecoder(parse_constant=_refuse)
    found: list[tuple[int, dict[str, Any]]] = []
    start = text.find("{")
    while start >= 0:
        end = start + 1
        try:
            value, end = decoder.raw_decode(text, start)
        except (ValueError, RecursionError):
            pass
        else:
            found.append((end - start, value))
        start = text.find("{", end)
    return [value for _, value in sorted(found, key=lambda item: -item[0])]


def _loads(text: str) -> Any:
    return json.loads(text, parse_constant=_refuse)


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is not JSON")


def _no_object(text: str) -> str:
    if not text.strip():
        return "the answer is empty"
    try:
        value = _loads(text)
    except RecursionError:
        return "the JSON is nested too deeply"
    except ValueError as error:
        return f"no JSON object in it ({error}); it starts {text.strip()[:80]!r}"
    return f"a JSON object is needed, got {type(value).__name__}"


def _shorten(reason: str) -> str:
    return reason if len(reason) <= _REASON_CHARS else reason[:_REASON_CHARS] + " ..."

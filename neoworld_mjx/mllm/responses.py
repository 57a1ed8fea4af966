"""Validated responses from a model's text: find the JSON, validate it, report the errors."""

import json
import re
from itertools import islice
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ..io.validation_message import validation_message

T = TypeVar("T", bound=BaseModel)

_FENCE = re.compile(r"```[A-Za-z0-9_-]*[ \t]*\r?\n(.*?)```", re.DOTALL)
_OPENING = re.compile(r"\{(?=\s*[\"}])")
_REASON_CHARS = 2000
MAX_CHARS, MAX_OBJECTS = 1_000_000, 20
"""Longest response, and most JSON objects in it among which the response is looked for."""


class InvalidResponse(Exception):
    """A text holds no JSON object, or one that does not fit the schema; the message says why."""


def read_response(text: str, schema: type[T]) -> T:
    """Validate the JSON object in a model's text.

    The text may be bare JSON, JSON in a fenced block, or JSON with prose around it. Of several
    objects the first that validates counts, bare text first, then fences, then the largest.

    Raises:
        InvalidResponse: nothing validates; the message is about the most likely object.
    """
    if len(text) > MAX_CHARS:
        raise InvalidResponse(
            f"the response has {len(text)} characters, at most {MAX_CHARS} are read"
        )
    whole = _whole(text)
    inside, broken = ([], "") if whole else _embedded(text)
    reason = broken
    for value in (*whole, *inside):
        try:
            # Through JSON again, as only then lists may become tuples and strings enums.
            return schema.model_validate_json(json.dumps(value))
        except ValidationError as error:
            reason = reason or _shorten(validation_message(error, schema))
    raise InvalidResponse(reason or _no_object(text))


def is_json(text: str) -> bool:
    """Return whether a text as a whole is one JSON value, and so complete."""
    try:
        _loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _whole(text: str) -> list[dict[str, Any]]:
    """Return the objects that are the whole text or a whole fenced block of it."""
    objects = []
    fenced = (match[1] for match in islice(_FENCE.finditer(text), MAX_OBJECTS))
    for part in (text, *fenced):
        try:
            value = _loads(part)
        except (ValueError, RecursionError):
            continue
        if isinstance(value, dict):
            objects.append(value)
    return objects


def _embedded(text: str) -> tuple[list[dict[str, Any]], str]:
    """Return the objects inside a text, the largest first, and the error that ended the search.

    A broken object ends the search: an object inside it could pass for the response.
    """
    decoder = json.JSONDecoder(parse_constant=_refuse)
    objects: list[tuple[int, dict[str, Any]]] = []
    broken = ""
    for match in _OPENING.finditer(text):
        if objects and match.start() < objects[-1][0]:
            continue
        try:
            value, end = decoder.raw_decode(text, match.start())
        except RecursionError:
            broken = "the JSON is nested too deeply"
            break
        except ValueError as error:
            broken = f"the JSON object in it is broken ({error})"
            break
        objects.append((end, value))
        if len(objects) > MAX_OBJECTS:
            return [], f"it holds over {MAX_OBJECTS} JSON objects; give one"
    largest_first = sorted(objects, key=lambda item: -len(json.dumps(item[1])))
    return [value for _, value in largest_first], broken


def _loads(text: str) -> Any:
    return json.loads(text, parse_constant=_refuse)


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is not JSON")


def _no_object(text: str) -> str:
    if not text.strip():
        return "the response is empty"
    try:
        value = _loads(text)
    except RecursionError:
        return "the JSON is nested too deeply"
    except ValueError as error:
        return f"no JSON object in it ({error}); it starts {text.strip()[:80]!r}"
    return f"a JSON object is needed, got {type(value).__name__}"


def _shorten(reason: str) -> str:
    return reason if len(reason) <= _REASON_CHARS else reason[:_REASON_CHARS] + " ..."

"""Extraction and validation of the JSON object in a model's text."""

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
"""Maximum number of characters of a text, and maximum number of JSON objects in the text."""


class InvalidResponse(Exception):
    """Raised if a text contains no JSON object that fits the schema; the message says why."""


def read_response(text: str, schema: type[T]) -> T:
    """Validate the JSON object in a model's text.

    The text may be bare JSON, JSON in a fenced block, or JSON within prose. If there are several
    objects, the first valid one is returned: first the whole text, then the fenced blocks. Objects
    within prose are used only if there is neither, from the largest to the smallest.

    Raises:
        InvalidResponse: no object is valid; the message describes the first problem.
    """
    if len(text) > MAX_CHARS:
        raise InvalidResponse(
            f"the response has {len(text)} characters, at most {MAX_CHARS} are read"
        )
    candidates, reason = _whole_objects(text), ""
    if not candidates:
        candidates, reason = _embedded_objects(text)
    for value in candidates:
        try:
            # Only validation from JSON converts lists to tuples and strings to enums.
            return schema.model_validate_json(json.dumps(value))
        except ValidationError as error:
            reason = reason or _shorten(validation_message(error, schema))
    raise InvalidResponse(reason or _no_object(text))


def is_json(text: str) -> bool:
    """Return True if a text is exactly one JSON value, and is therefore complete."""
    try:
        _loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _whole_objects(text: str) -> list[dict[str, Any]]:
    """Return the JSON objects that are the whole text or the whole content of a fenced block."""
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


def _embedded_objects(text: str) -> tuple[list[dict[str, Any]], str]:
    """Return the JSON objects within a text, largest first, and the error that ended the search.

    A malformed object ends the search, because an object nested in it could be mistaken for the
    response.
    """
    decoder = json.JSONDecoder(parse_constant=_reject_constant)
    objects: list[tuple[int, dict[str, Any]]] = []
    error_message = ""
    for match in _OPENING.finditer(text):
        if objects and match.start() < objects[-1][0]:
            continue
        try:
            value, end = decoder.raw_decode(text, match.start())
        except RecursionError:
            error_message = "the JSON is nested too deeply"
            break
        except ValueError as error:
            error_message = f"the JSON object in it is broken ({error})"
            break
        objects.append((end, value))
        if len(objects) > MAX_OBJECTS:
            return [], f"it holds over {MAX_OBJECTS} JSON objects; give one"
    largest_first = sorted(objects, key=lambda item: -len(json.dumps(item[1])))
    return [value for _, value in largest_first], error_message


def _loads(text: str) -> Any:
    return json.loads(text, parse_constant=_reject_constant)


def _reject_constant(constant: str) -> Any:
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

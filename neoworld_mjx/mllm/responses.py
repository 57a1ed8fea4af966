"""Extraction and validation of the JSON object in a model's text."""

import json
import re
from collections.abc import Iterator
from itertools import islice
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ..io.validation_message import validation_message

T = TypeVar("T", bound=BaseModel)

_FENCE = re.compile(r"```[A-Za-z0-9_-]*[ \t]*\r?\n(.*?)```", re.DOTALL)
_OPENING = re.compile(r"\{(?=\s*[\"}])")
_REASON_CHARS = 2000
MAX_CHARS, MAX_BLOCKS = 1_000_000, 20
"""Maximum number of characters of a text, and maximum number of fenced blocks that are read."""


class InvalidResponse(Exception):
    """Raised if a text contains no JSON object that fits the schema; the message says why."""


def read_response(text: str, schema: type[T]) -> T:
    """Validate the JSON object in a model's text.

    The text may be bare JSON, JSON in fenced blocks, or JSON within prose. The whole text, the
    fenced blocks, and the text from the first to the last brace are tried in this order, and the
    first valid object is returned.

    Raises:
        InvalidResponse: no object is valid; the message describes the first problem.
    """
    if len(text) > MAX_CHARS:
        raise InvalidResponse(
            f"the response has {len(text)} characters, at most {MAX_CHARS} are read"
        )
    reason = ""
    for part in _candidates(text):
        try:
            value = _loads(part)
        except RecursionError:
            reason = reason or "the JSON is nested too deeply"
            continue
        except ValueError as error:
            reason = reason or f"no JSON object in it ({error}); it starts {text.strip()[:80]!r}"
            continue
        if not isinstance(value, dict):
            reason = f"a JSON object is needed, got {type(value).__name__}"
            continue
        try:
            # Only validation from JSON converts lists to tuples and strings to enums.
            return schema.model_validate_json(json.dumps(value))
        except ValidationError as error:
            reason = _shorten(validation_message(error, schema))
    raise InvalidResponse(reason if text.strip() else "the response is empty")


def is_json(text: str) -> bool:
    """Return True if a text is exactly one JSON value, and is therefore complete."""
    try:
        _loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _candidates(text: str) -> Iterator[str]:
    yield text
    yield from (match[1] for match in islice(_FENCE.finditer(text), MAX_BLOCKS))
    if opening := _OPENING.search(text):
        # A slice to the last brace never takes a nested object of a broken one for the response.
        yield text[opening.start() : text.rfind("}") + 1]


def _loads(text: str) -> Any:
    return json.loads(text, parse_constant=_reject_constant)


def _reject_constant(constant: str) -> Any:
    raise ValueError(f"{constant} is not JSON")


def _shorten(reason: str) -> str:
    return reason if len(reason) <= _REASON_CHARS else reason[:_REASON_CHARS] + " ..."

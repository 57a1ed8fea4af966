"""JSON files from outside."""

import json
import re
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ..errors import NeoWorldError
from .bounds import bounds_of_files
from .text_files import read_outside_text
from .validation_message import validation_message

T = TypeVar("T", bound=BaseModel)
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_SHOWN = 1000


def read_json(path: Path, error: type[NeoWorldError], kind: str = "") -> Any:
    """Read a JSON value.

    Args:
        path: the file.
        error: class of the error to raise.
        kind: of the file, for messages, such as "tape".

    Raises:
        NeoWorldError: of the class `error`: the file cannot be read, is no JSON, or is larger,
            deeper or longer than `files` of the configuration allows.
    """
    text = _checked(path, error, kind)
    try:
        value = json.loads(text, parse_constant=_refuse)
        if _SURROGATE.search(text):
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError:
        raise error(_too_deep(path)) from None
    except UnicodeEncodeError:
        raise error(f"{path} holds half a character: write it anew as UTF-8") from None
    except ValueError as problem:
        raise error(f"{path} is no JSON: {problem}; get or write the file again") from None
    _check_depth(value, path, error)
    return value


def read_object(path: Path, error: type[NeoWorldError], kind: str = "") -> dict[str, Any]:
    """Read a JSON object; see `read_json`."""
    value = read_json(path, error, kind)
    if not isinstance(value, dict):
        raise error(f"{path} must hold a JSON object, got {type(value).__name__}")
    return value


def read_model(path: Path, schema: type[T], error: type[NeoWorldError], kind: str) -> T:
    """Read a JSON file that a pydantic model describes.

    Args:
        path: the file.
        schema: the model.
        error: class of the error to raise.
        kind: of the file, for messages, such as "a tape".

    Raises:
        NeoWorldError: of the class `error`, as `read_json`; also if the schema does not fit.
    """
    text = _checked(path, error, "")
    try:
        return schema.model_validate_json(text)
    except ValidationError as problem:
        why = validation_message(problem, schema)
        why = why if len(why) <= _SHOWN else why[:_SHOWN] + " ..."
        raise error(f"{path} is not {kind}: {why}") from None
    except RecursionError:
        raise error(_too_deep(path)) from None


def _checked(path: Path, error: type[NeoWorldError], kind: str) -> str:
    """Return the text of a file that has not too many values."""
    text = read_outside_text(path, error, kind)
    most = bounds_of_files().max_values
    if sum(map(text.count, ",[{")) > most:
        raise error(f"{path} holds over {most} values; if you trust it, raise files.max_values")
    return text


def _check_depth(value: Any, path: Path, error: type[NeoWorldError]) -> None:
    level, depth = [value], 0
    while level:
        depth += 1
        if depth > bounds_of_files().max_depth + 1:
            raise error(_too_deep(path))
        below = []
        for each in level:
            children = each.values() if isinstance(each, dict) else each
            if isinstance(each, dict | list):
                below += [child for child in children if isinstance(child, dict | list)]
        level = below


def _too_deep(path: Path) -> str:
    return f"{path} is nested over {bounds_of_files().max_depth} levels deep, which is not read"


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is no number of JSON")

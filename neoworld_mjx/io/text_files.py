"""Readers of untrusted text, JSON and YAML, with limits on size, nesting and number of values.

What does not fit a pydantic model is reported in one line.
"""

import json
import re
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from ..errors import ConfigError, NeoWorldError, choices
from .files import MIB, read_text
from .limited_worker import file_bounds

_SECRET = "base_url"
"""Option whose invalid values are not displayed because they may contain API keys."""


def validation_message(error: ValidationError, model: type[BaseModel]) -> str:
    """Return a one-line message that lists each invalid key with its value or valid choices."""
    lines = []
    for item in error.errors():
        key = ".".join(str(step) for step in item["loc"]) or "(root)"
        if item["type"] == "extra_forbidden":
            keys = _keys_at(model, item["loc"][:-1])
            lines.append(f"unknown key {key}: {choices(str(item['loc'][-1]), keys)}")
        elif _SECRET in item["loc"]:
            lines.append(f"{key}: {item['msg']}")
        else:
            value = repr(item["input"])
            value = value if len(value) <= 80 else value[:77] + "..."
            lines.append(f"{key}: {item['msg']}, got {value}")
    return "; ".join(lines)


def _keys_at(model: type[BaseModel], path: tuple[Any, ...]) -> list[str]:
    for step in path:
        field = model.model_fields.get(str(step))
        inner = field.annotation if field is not None else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return []
        model = inner
    return sorted(model.model_fields)


T = TypeVar("T", bound=BaseModel)
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
MAX_VALUES = 4_000_000
"""Maximum number of values in a JSON file or a table."""
MAX_DEPTH = 100
"""Maximum nesting depth of JSON, YAML and XML."""
_MAX_MESSAGE = 1000


def read_untrusted_text(path: Path, error: type[NeoWorldError], kind: str = "") -> str:
    """Read an untrusted text file of at most `files.max_file_mib`.

    Args:
        path: the file.
        error: class of the error to raise.
        kind: kind of file for messages, such as "tape".

    Raises:
        NeoWorldError: of the class `error`: the file is missing, not a regular file, too large,
            or not UTF-8.
    """
    try:
        return read_text(Path(path), file_bounds().max_file_mib * MIB)
    except OSError as problem:
        raise error(f"cannot read {kind}{' ' * bool(kind)}{path}: {problem.strerror}") from None


def read_json(path: Path, error: type[NeoWorldError], kind: str = "") -> Any:
    """Read a JSON value. The arguments are those of `read_untrusted_text`.

    Raises:
        NeoWorldError: of the class `error`: the file cannot be read, is not JSON, or exceeds a
            limit: the size `files.max_file_mib`, the nesting depth or the number of values.
    """
    text = _checked_text(path, error, kind)
    try:
        value = json.loads(text, parse_constant=_reject_constant)
        if _SURROGATE.search(text):
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError:
        raise error(_too_deep(path)) from None
    except UnicodeEncodeError:
        raise error(f"{path} holds an unpaired surrogate: save it again as UTF-8") from None
    except ValueError as problem:
        raise error(f"{path} is not JSON: {problem}; replace or regenerate the file") from None
    if _is_too_deep(value):
        raise error(_too_deep(path))
    return value


def read_object(path: Path, error: type[NeoWorldError]) -> dict[str, Any]:
    """Read a JSON object; see `read_json`."""
    value = read_json(path, error)
    if not isinstance(value, dict):
        raise error(f"{path} must hold a JSON object, got {type(value).__name__}")
    return value


def read_model(path: Path, schema: type[T], error: type[NeoWorldError], kind: str) -> T:
    """Read a JSON file and validate it with a pydantic model.

    Args:
        path: the file.
        schema: the model.
        error: class of the error to raise.
        kind: kind of file for messages, with an article, such as "a tape".

    Raises:
        NeoWorldError: of the class `error`, as in `read_json`, or if the value does not match the
            schema.
    """
    text = _checked_text(path, error, "")
    try:
        return schema.model_validate_json(text)
    except ValidationError as problem:
        reason = validation_message(problem, schema)
        reason = reason if len(reason) <= _MAX_MESSAGE else reason[:_MAX_MESSAGE] + " ..."
        raise error(f"{path} is not {kind}: {reason}") from None
    except RecursionError:
        raise error(_too_deep(path)) from None


def strict_json(value: Any) -> Any:
    """Return a value as plain JSON that `read_json` accepts.

    NumPy scalars become numbers, NaN and Infinity become null, and unpaired surrogates, with which
    Python represents file names that are not UTF-8, become "?".
    """
    text = json.dumps(value, default=lambda scalar: scalar.item(), ensure_ascii=False)
    plain = text.encode("utf-8", "replace").decode()
    return json.loads(plain, parse_constant=lambda _: None)


def _checked_text(path: Path, error: type[NeoWorldError], kind: str) -> str:
    """Read the text of a JSON file and check that its number of values is within the limit."""
    text = read_untrusted_text(path, error, kind)
    if sum(map(text.count, ",[{")) > MAX_VALUES:
        raise error(f"{path} holds over {MAX_VALUES} values")
    return text


def _is_too_deep(value: Any) -> bool:
    """Return True if containers are nested more than MAX_DEPTH levels below the outermost one."""
    level = [value]
    for _ in range(MAX_DEPTH + 1):
        children = [
            child
            for container in level
            if isinstance(container, dict | list)
            for child in (container.values() if isinstance(container, dict) else container)
        ]
        level = [child for child in children if isinstance(child, dict | list)]
        if not level:
            return False
    return True


def _too_deep(path: Path) -> str:
    return f"{path} is nested over {MAX_DEPTH} levels deep"


def _reject_constant(constant: str) -> Any:
    raise ValueError(f"{constant} is not a JSON number")


_MAX_BYTES = 256 << 10


class _BoundedLoader(yaml.SafeLoader):
    """Loader of plain values that rejects deep nesting and aliases.

    Aliases of aliases expand exponentially, so a few lines can exhaust the memory.
    """

    _depth = 0

    def fetch_flow_collection_start(self, TokenClass: Any) -> None:
        if self.flow_level >= MAX_DEPTH:
            raise yaml.YAMLError(f"it is nested over {MAX_DEPTH} levels deep")
        super().fetch_flow_collection_start(TokenClass)

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it holds an alias (*name): write out the values")
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise yaml.YAMLError(f"it is nested over {MAX_DEPTH} levels deep")
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def parse_yaml(text: str) -> Any:
    """Return the value of a YAML document.

    Raises:
        ValueError: the document contains something other than plain values, is nested too deeply,
            or contains aliases.
    """
    try:
        return _BoundedLoader(text).get_single_data()
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise ValueError(str(error)) from None


def read_yaml(path: Path, kind: str, error: type[NeoWorldError] = ConfigError) -> Any:
    """Read a YAML file.

    Args:
        path: the file.
        kind: kind of file for messages, such as "config".
        error: class of the error to raise.

    Raises:
        NeoWorldError: of the class `error`: the file cannot be read, is larger than 256 KiB, or is
            not YAML of plain values.
    """
    try:
        return parse_yaml(read_text(Path(path), _MAX_BYTES))
    except OSError as problem:
        raise error(f"cannot read {kind} {path}: {problem.strerror}") from None
    except ValueError as problem:
        reason = " ".join(str(problem).split())
        raise error(f"{kind} {path} is not valid YAML: {reason}") from None

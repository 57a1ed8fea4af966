"""Reader of untrusted YAML that limits size and nesting depth and rejects aliases."""

from pathlib import Path
from typing import Any

import yaml

from ..errors import ConfigError
from .files import read_text
from .json_files import MAX_DEPTH

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


def read_yaml(path: Path, kind: str) -> Any:
    """Read a YAML file.

    Args:
        path: the file.
        kind: kind of file for messages, such as "config".

    Raises:
        ConfigError: the file cannot be read, is larger than 256 KiB, or is not YAML of plain
            values.
    """
    try:
        return parse_yaml(read_text(Path(path), _MAX_BYTES))
    except OSError as error:
        raise ConfigError(f"cannot read {kind} {path}: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{kind} {path} is not valid YAML: {error}") from None

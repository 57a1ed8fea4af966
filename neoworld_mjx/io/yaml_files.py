"""YAML from outside: bounded in size and depth, without aliases."""

from pathlib import Path
from typing import Any

import yaml

from ..errors import ConfigError
from .file_options import FileOptions
from .files import read_text

_KIB = 1024


class _Bounded(yaml.SafeLoader):
    """A loader of plain values that ends at too deep a nesting and at aliases.

    An alias stands for a whole tree, so a few lines of them stand for more than any memory.
    """

    max_depth = FileOptions().max_depth
    _depth = 0

    def fetch_flow_collection_start(self, TokenClass: Any) -> None:
        if self.flow_level >= self.max_depth:
            raise yaml.YAMLError(f"it is nested over {self.max_depth} levels deep")
        super().fetch_flow_collection_start(TokenClass)

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it holds an alias (*name): write the values out")
        self._depth += 1
        if self._depth > self.max_depth:
            raise yaml.YAMLError(f"it is nested over {self.max_depth} levels deep")
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def parse_yaml(text: str) -> Any:
    """Return the value of a YAML text.

    Raises:
        ValueError: it is no YAML of plain values, nested too deep, or holds aliases.
    """
    try:
        return _Bounded(text).get_single_data()
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise ValueError(str(error)) from None


def read_yaml(path: Path, kind: str) -> Any:
    """Read a YAML file.

    Args:
        path: the file.
        kind: of the file, for messages, such as "config".

    Raises:
        ConfigError: it cannot be read, is larger than `files.max_yaml_kib` allows, or is no YAML of
            plain values.
    """
    try:
        return parse_yaml(read_text(Path(path), FileOptions().max_yaml_kib * _KIB))
    except OSError as error:
        raise ConfigError(f"cannot read {kind} {path}: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{kind} {path} is not valid YAML: {error}") from None

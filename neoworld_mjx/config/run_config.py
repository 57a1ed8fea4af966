"""All options of a run in one validated tree, read from YAML.

A configuration file states only what differs from the defaults; unknown keys are errors that name
the key and its valid neighbours.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..errors import ConfigError
from ..io.file_options import FileOptions
from ..io.validation_message import validation_message
from ..io.yaml_files import read_yaml
from ..options import Options, option
from .model_options import MLLMOptions
from .object_options import (
    ComposeOptions,
    ParseOptions,
    ProgramOptions,
    RenderOptions,
    VerifyOptions,
)
from .search_options import RefineOptions


class Config(Options):
    """All options of a run."""

    seed: int = option(0, "Seed of every random draw of the run.", ge=0)
    provider: str = option(
        "auto",
        "Where models' answers come from: auto, anthropic, openai, replay or mailbox; see "
        "docs/models.md.",
    )
    mllm: MLLMOptions = MLLMOptions()
    parse: ParseOptions = ParseOptions()
    program: ProgramOptions = ProgramOptions()
    verify: VerifyOptions = VerifyOptions()
    compose: ComposeOptions = ComposeOptions()
    refine: RefineOptions = RefineOptions()
    render: RenderOptions = RenderOptions()
    files: FileOptions = FileOptions()

    def fingerprint(self) -> str:
        """Return 16 hex digits that change whenever any option changes."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def load_config(path: Path | None = None, overrides: dict[str, Any] | None = None) -> Config:
    """Read a YAML file of options and lay overrides over it.

    Args:
        path: the file; None means the defaults alone.
        overrides: a nested mapping that wins over the file, such as {"seed": 3}.

    Raises:
        ConfigError: the file is missing or no YAML mapping, or a key or value is wrong; the message
            names the file, the key's full path and the valid keys.
    """
    data: dict[str, Any] = {}
    if path is not None:
        data = _read_mapping(path)
    data = merged(data, overrides or {})
    try:
        return Config.model_validate(data)
    except ValidationError as error:
        where = str(path) if path is not None else "options"
        raise ConfigError(f"{where}: {validation_message(error, Config)}") from None


def _read_mapping(path: Path) -> dict[str, Any]:
    data = read_yaml(path, "config")
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError(f"config {path} must be a mapping of options, got {type(data).__name__}")
    return data


def merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Lay one nested mapping over another."""
    result = dict(base)
    for key, value in over.items():
        old = result.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            value = merged(old, value)
        result[key] = value
    return result

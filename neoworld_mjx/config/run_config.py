"""Configuration of a run: a validated tree of all options, read from YAML.

A configuration file needs only the values that differ from the defaults. An unknown key is an
error; the message names this key and the valid keys.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..errors import ConfigError
from ..io.limited_worker import FileOptions
from ..io.text_files import read_yaml, validation_message
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

    seed: int = option(0, "Seed of all random numbers of the run.", ge=0)
    provider: str = option(
        "auto",
        "Source of the models' responses: auto, anthropic, openai, replay or mailbox; see "
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


WITHOUT_CRITICS: dict[str, Any] = {
    "parse": {"critic_rounds": 0},
    "program": {"critic_rounds": 0},
    "verify": {"critic": "never"},
}
"""Options of a run that asks for each response once: no critic, and no revision by one."""


def load_config(path: Path | None = None, overrides: dict[str, Any] | None = None) -> Config:
    """Load the configuration from a YAML file and overrides.

    Args:
        path: the file. If None, all values that `overrides` lacks are the defaults.
        overrides: nested mapping that takes precedence over the file, such as {"seed": 3}.

    Raises:
        ConfigError: the file is missing or not a YAML mapping, or a key or value is invalid; the
            message names the file, the key's full path and the valid keys.
    """
    data = None if path is None else read_yaml(path, "config")
    data = {} if data is None else data
    if not isinstance(data, dict):
        raise ConfigError(f"config {path} must be a mapping of options, got {type(data).__name__}")
    try:
        return Config.model_validate(merged(data, overrides or {}))
    except ValidationError as error:
        source = "options" if path is None else path
        raise ConfigError(f"{source}: {validation_message(error, Config)}") from None


def merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of the nested mapping `base` that is updated recursively with `over`."""
    result = base | over
    for key in base.keys() & over.keys():
        if isinstance(base[key], dict) and isinstance(over[key], dict):
            result[key] = merged(base[key], over[key])
    return result

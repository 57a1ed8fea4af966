"""User-named methods: the search with other options, as rows next to the built-in methods.

A results folder lists the options of every method in methods.json. Within a folder, each name
stands for one set of options.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from neoworld_mjx.config import Config, RefineOptions, merged, option_values, read_yaml
from neoworld_mjx.errors import ConfigError, RunError
from neoworld_mjx.io import read_object
from neoworld_mjx.io.files import write_output
from neoworld_mjx.io.validation_message import validation_message
from neoworld_mjx.sweeps.result import commit

from .scene_methods import METHODS

METHODS_FILE = "methods.json"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,60}")


class NamedMethods(NamedTuple):
    """Methods of a run."""

    methods: tuple[str, ...]
    """Names from METHODS or from `options`, or optimizers."""
    options: tuple[tuple[str, RefineOptions], ...]
    """Name and options of each search that a user named."""


def read_methods(names: Sequence[str], label: str | None, config: Config) -> NamedMethods:
    """Read the methods of a command line.

    Args:
        names: methods of METHODS, optimizers such as `evosax:SNES`, and NAME=FILE for the search
            with the options of a YAML file on top of the configuration.
        label: name under which the rows of `ours` appear. If None, the name is `ours`.
        config: the configuration.

    Raises:
        ConfigError: a name is taken, or a file or an option is invalid.
    """
    methods: list[str] = []
    options: dict[str, RefineOptions] = {}
    for text in names:
        name, equals, file = text.partition("=")
        if equals:
            _check_name(f"--method {text}", name, options)
            options[name] = _options(Path(file), config)
        elif name == "ours" and label is not None:
            _check_name(f"--label {label}", label, options)
            name, options[label] = label, config.refine
        methods.append(name)
    if label is not None and label not in options:
        raise ConfigError(f"--label {label} names the row of ours: add ours to --method")
    return NamedMethods(tuple(dict.fromkeys(methods)), tuple(options.items()))


def _check_name(where: str, name: str, taken: Mapping[str, Any]) -> None:
    if name in METHODS or name in taken:
        raise ConfigError(f"{where}: the name {name} is taken")
    if not NAME.fullmatch(name):
        raise ConfigError(f"{where}: a name has letters, digits and _ . + - only, got {name!r}")


def _options(file: Path, config: Config) -> RefineOptions:
    changes = read_yaml(file, "options of a method")
    if not isinstance(changes, dict) or set(changes) != {"refine"}:
        raise ConfigError(f"{file}: options of a method are those under refine, and no others")
    try:
        return Config.model_validate(merged(config.model_dump(mode="json"), changes)).refine
    except ValidationError as error:
        raise ConfigError(f"{file}: {validation_message(error, Config)}") from None


def note_methods(folder: Path, used: Mapping[str, dict[str, Any]], has_rows: set[str]) -> None:
    """Record the options of a run's methods in its folder.

    Args:
        folder: the results folder, which exists.
        used: JSON of the options of each method.
        has_rows: methods whose rows the folder already contains.

    Raises:
        RunError: a method has rows with other options, or the file cannot be read or written.
    """
    path = folder / METHODS_FILE
    known = read_object(path, RunError) if path.exists() else {}
    for method, options in used.items():
        earlier = known.get(method, {}).get("options")
        if earlier is None and method in has_rows:
            raise RunError(f"{folder} has rows of {method} with unknown options: name a new folder")
        if earlier is not None and method in has_rows and earlier != options:
            raise RunError(
                f"{folder} has rows of {method} with other options ({_change(earlier, options)}): "
                "name a new folder, or give this run's rows a name with --label"
            )
        known[method] = {"options": options, "commit": commit()}
    write_output(path, json.dumps(known, indent=1, sort_keys=True) + "\n", RunError)


def _change(earlier: Any, now: Any, path: str = "") -> str:
    """Return the first option that differs, with both values."""
    if isinstance(earlier, dict) and isinstance(now, dict):
        for name in sorted({*earlier, *now}):
            if earlier.get(name) != now.get(name):
                return _change(earlier.get(name), now.get(name), f"{path}.{name}".lstrip("."))
    return f"{path} was {earlier}, is {now}"


def options_json(refine: RefineOptions, **more: Any) -> dict[str, Any]:
    """Return the options, by path, as a JSON object with `more` entries."""
    return {"refine": option_values(refine), **more}

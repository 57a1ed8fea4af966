"""Base classes of commands: output flags and configuration."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import UseAppendAction, arg

from ..errors import ConfigError

if TYPE_CHECKING:
    from ..config import Config

CommandResult = dict[str, Any]
"""JSON object that a command returns; its entry "passed" decides the exit code."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Options of all commands."""

    ends_by_interrupt: ClassVar[bool] = False
    """If True, the command runs until Ctrl-C and then returns a result."""
    owns_stdout: ClassVar[bool] = False
    """If True, the command itself writes to stdout, such as a protocol."""

    json: bool = False
    """Print the result as one JSON object on stdout, and everything else on stderr."""
    quiet: bool = False
    """Print no progress."""
    verbose: Annotated[bool, arg(aliases=("-v",))] = False
    """Print the whole result as YAML, and all progress messages."""
    debug: bool = False
    """Print the traceback of an error."""

    def run(self) -> CommandResult:
        """Run the command and return its result.

        Raises:
            NeoWorldError: the input is invalid.
        """
        raise NotImplementedError

    def lines(self, result: CommandResult) -> list[str]:
        """Return the lines of a short summary of a result; by default, its entries."""
        return [
            f"{key}: {' x '.join(map(str, value)) if isinstance(value, list) else value}"
            for key, value in result.items()
        ]


@dataclass(frozen=True, kw_only=True)
class ConfiguredCommand(Command):
    """Options of commands with a configuration."""

    config: Path | None = None
    """YAML file of options that differ from the defaults."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """One option as KEY=VALUE, such as --set refine.cem.population=64; repeatable."""

    def load_config(self, flags: dict[str, Any] | None = None) -> "Config":
        """Load the configuration.

        The options of --set override the file, and the command's flags override --set.

        Args:
            flags: values of the command's flags by the path of the option; None if a flag is not
                given.
        """
        from ..config import load_config, parse_yaml
        from ..io import set_file_bounds

        overrides: dict[str, Any] = {}
        for setting in self.set:
            key, equals, value = setting.partition("=")
            if not equals or not key:
                raise ConfigError(f"--set takes KEY=VALUE, such as seed=3, got {setting!r}")
            try:
                _put(overrides, key, parse_yaml(value))
            except ValueError:
                raise ConfigError(f"--set {key}: {value!r} is not a YAML value") from None
        for key, value in (flags or {}).items():
            if value is not None:
                _put(overrides, key, value)
        config = load_config(self.config, overrides)
        set_file_bounds(config.files)
        return config


def _put(tree: dict[str, Any], key: str, value: Any) -> None:
    *path, last = key.split(".")
    for name in path:
        inner = tree.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(f"--set {key}: {name} is set to a value already")
        tree = inner
    tree[last] = value

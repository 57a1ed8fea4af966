"""Base of all commands: the flags of output, and the configuration."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, runtime_checkable

from tyro.conf import UseAppendAction, arg

from ..errors import ConfigError

if TYPE_CHECKING:
    from ..config import Config

CommandResult = dict[str, Any]
"""A JSON object; its entry "passed" decides the exit code."""


@runtime_checkable
class Runnable(Protocol):
    """A command that the command line runs, or a group of nested commands."""

    @property
    def json(self) -> bool:
        """Whether one JSON object is printed."""
        ...

    @property
    def quiet(self) -> bool:
        """Whether no progress is printed."""
        ...

    @property
    def verbose(self) -> bool:
        """Whether every detail is printed."""
        ...

    def run(self) -> CommandResult:
        """Do the work and return what is to be printed."""
        ...

    def lines(self, result: CommandResult) -> list[str] | None:
        """Return an answer in few lines, for people; None prints all of it."""
        ...


@dataclass(frozen=True, kw_only=True)
class Command:
    """Options of every command."""

    json: bool = False
    """Print one JSON object on stdout, and everything else on stderr."""
    quiet: bool = False
    """Print no progress."""
    verbose: Annotated[bool, arg(aliases=("-v",))] = False
    """Print all details of the answer, and every line of progress."""
    debug: bool = False
    """Show the traceback of an error."""

    def run(self) -> CommandResult:
        """Do the work and return what is to be printed.

        Raises:
            NeoWorldError: the input is wrong.
        """
        raise NotImplementedError

    def lines(self, result: CommandResult) -> list[str] | None:
        """Return an answer in few lines, for people; None, the default, prints all of it."""
        return None


@dataclass(frozen=True, kw_only=True)
class ConfiguredCommand(Command):
    """Options of the commands that take a configuration."""

    config: Path | None = None
    """YAML of options; only what differs from the defaults."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """One option as KEY=VALUE, such as --set refine.cem.population=64; may be repeated."""

    def load_config(self, flags: dict[str, Any] | None = None) -> "Config":
        """Lay --set over the file, and the command's own flags over both.

        Args:
            flags: values by path of the option; None is a flag that was not given.
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

"""The `bench` command: run suites, and write the data set."""

import dataclasses
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Union

from tyro.conf import subcommand

from neoworld_mjx.commands.base_command import Command, CommandResult, ConfiguredCommand
from neoworld_mjx.commands.result_lines import DETAILS, wrapped
from neoworld_mjx.errors import ConfigError

from .suites import SUITES, Suite


def check_numbers(options: Any) -> None:
    """Check that counts and durations among a command's options are positive and finite.

    Raises:
        ConfigError: a number is out of range.
    """
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        zero = field.default in (0, None, ())  # numbers of scenes begin with 0
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, bool) or not isinstance(number, int | float):
                continue
            if not math.isfinite(number) or number < 0 or (number == 0 and not zero):
                whole = "1 or more" if isinstance(number, int) else "above 0"
                least = "0 or more" if zero else whole
                name = field.name.replace("_", "-")
                raise ConfigError(f"--{name} must be {least}, got {number}")


@dataclass(frozen=True, kw_only=True)
class BenchMakeCommand(Command):
    """Write the benchmark's data set: objects of all categories, and the scenes with images,
    masks, depth, boxes, trees and joints.
    """

    out: Path
    """Folder to write; existing folders with the same content are not written again."""
    seed: int | None = None
    """Draw one instance of each category; by default programs keep their default parameters."""
    workers: int = 0
    """Processes; 0 starts one for each core."""
    scenes: tuple[str, ...] = ()
    """Names of the scenes to write, without the categories; all of both by default, which takes a
    quarter of an hour on two cores."""

    def run(self) -> CommandResult:
        """Write the data set."""
        check_numbers(self)
        from .dataset.make_dataset import make_dataset

        workers = self.workers or os.cpu_count() or 1
        return make_dataset(self.out, seed=self.seed, workers=workers, scenes=self.scenes)


class SuiteCommand:
    """Command that runs a suite; `suite_commands` adds the suite's options."""

    suite: ClassVar[Suite]
    suite_name: ClassVar[str]

    def run(self) -> CommandResult:
        """Run the suite, and add its name, the command and `provenance` to the result."""
        from neoworld_mjx.cache import keep_compilations
        from neoworld_mjx.search.optimizer import optimizer_factory

        from .machine import provenance

        check_numbers(self)
        keep_compilations()
        function = self.suite.load()
        configured = isinstance(self, ConfiguredCommand)
        if configured:
            config = self.load_config()
            # Before anything runs: the optimizer may need a package that is not installed.
            optimizer_factory(config.refine.optimizer)
            result = function(self, config)
        else:
            result = function(self)
        return {
            "suite": self.suite_name,
            "command": " ".join(["neoworld bench run", self.suite_name, *self._changed_options()]),
            **provenance(),
            "n": len(result.get("rows", [])),
            **result,
        }

    def _changed_options(self) -> Iterator[str]:
        """Yield the words of the options that differ from their defaults, --json last."""
        fields = dataclasses.fields(self)  # pyright: ignore[reportArgumentType]
        for field in sorted(fields, key=lambda field: field.name == "json"):
            value = getattr(self, field.name)
            if value == field.default or field.name in ("quiet", "verbose", "debug"):
                continue
            if not hasattr(field.type, "__metadata__"):  # Positional is an annotation.
                yield "--" + field.name.replace("_", "-")
            if value is not True:
                yield from map(str, value if isinstance(value, tuple) else (value,))


def _suite_commands() -> Any:
    """Return the union of the commands of the suites, for tyro."""
    commands = []
    for name, suite in SUITES.items():
        bases = (SuiteCommand, suite.options, ConfiguredCommand if suite.configured else Command)
        fields = {
            "__doc__": suite.options.__doc__,
            "__module__": __name__,
            "suite": suite,
            "suite_name": name,
        }
        command = dataclass(frozen=True, kw_only=True)(type(f"Bench{name.title()}", bases, fields))
        commands.append(Annotated[command, subcommand(name)])
    return Union[tuple(commands)]  # noqa: UP007


if TYPE_CHECKING:
    SuiteChoice = Any
else:
    SuiteChoice = _suite_commands()


@dataclass(frozen=True, kw_only=True)
class BenchRunCommand:
    """Run a benchmark."""

    suite: SuiteChoice


@dataclass(frozen=True, kw_only=True)
class BenchCommand:
    """Run benchmarks of methods and engines, and write their data set."""

    ends_by_interrupt: ClassVar[bool] = False
    owns_stdout: ClassVar[bool] = False

    task: (
        Annotated[BenchRunCommand, subcommand("run")]
        | Annotated[BenchMakeCommand, subcommand("make")]
    )

    @property
    def inner(self) -> Any:
        """Innermost command."""
        return self.task.suite if isinstance(self.task, BenchRunCommand) else self.task

    @property
    def json(self) -> bool:
        """See `Command`."""
        return self.inner.json

    @property
    def quiet(self) -> bool:
        """See `Command`."""
        return self.inner.quiet

    @property
    def verbose(self) -> bool:
        """See `Command`."""
        return self.inner.verbose

    @property
    def debug(self) -> bool:
        """See `Command`."""
        return self.inner.debug

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return bench_lines(result)

    def check_inputs(self) -> None:
        """See `Command`."""
        self.inner.check_inputs()

    def run(self) -> CommandResult:
        """Run the innermost command."""
        return self.inner.run()


def bench_lines(result: CommandResult) -> list[str]:
    """Summarize the numbers of a benchmark, without its rows."""
    tables = [
        f"{len(value)} {key}" for key, value in result.items() if isinstance(value, list) and value
    ]
    numbers = [
        f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
        for key, value in result.items()
        if isinstance(value, int | float)
    ]
    rows = [f"{result['suite']}: {', '.join(tables) or 'done'}"] if "suite" in result else []
    return [*rows, *wrapped(numbers), DETAILS]

"""The command bench: suites of the tables in `bench.suites` and `benchmarks.suites`, and charts."""

import dataclasses
import datetime
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Union

from tyro.conf import Positional, subcommand

from neoworld_mjx.commands.base_command import Command, CommandResult, ConfiguredCommand
from neoworld_mjx.commands.listing_lines import bench_lines
from neoworld_mjx.errors import ConfigError

from .suites import DEVELOPER_SUITES, SUITES, Suite

MAY_BE_ZERO = ("delay_s", "directions", "failing", "pairs", "rounds", "scenes")
"""Numbers of suites that may be zero, beside those that are by default."""


def check_numbers(options: Any) -> None:
    """Check the numbers among a command's options: counts and durations are positive.

    Raises:
        ConfigError: one is too small, or not finite.
    """
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        zero = field.name in MAY_BE_ZERO or field.default in (0, None)
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, bool) or not isinstance(number, int | float):
                continue
            if not math.isfinite(number) or number < 0 or (number == 0 and not zero):
                whole = "1 or more" if isinstance(number, int) else "above 0"
                least = "0 or more" if zero else whole
                name = field.name.replace("_", "-")
                raise ConfigError(f"--{name} must be {least}, got {number}")


@dataclass(frozen=True, kw_only=True)
class BenchChartCommand(Command):
    """Draw the growth of cost from the JSON that `bench run physics` printed."""

    rows: Positional[Path]
    """File with what `bench run physics --json` printed."""
    out: Path
    """SVG file to write."""
    core: bool = False
    """Draw processor time, which a busy machine does not change."""

    def run(self) -> CommandResult:
        """Draw the chart."""
        from .run_suites import chart_result

        return chart_result(self)


@dataclass(frozen=True, kw_only=True)
class BenchMakeCommand(Command):
    """Write the benchmark's data set: objects of all categories, and the scenes with pictures,
    masks, depth, boxes, trees and joints.
    """

    out: Path
    """Folder to write; what is there already and the same is left alone."""
    seed: int | None = None
    """Draw one instance of each category; by default programs have their own parameters."""
    workers: int = 0
    """Processes; 0 takes all cores."""

    def run(self) -> CommandResult:
        """Write the data set."""
        check_numbers(self)
        from .run_suites import make_result

        return make_result(self)


@dataclass(frozen=True, kw_only=True)
class BenchTableCommand(Command):
    """Write tables of what `bench run` of scenes, joints and task-success measured with --out, in
    Markdown, CSV and LaTeX: table.*, joints.* and tasks.*, and curves over thresholds of scenes.
    """

    folder: Positional[Path]
    """Folder with results.parquet, joints.parquet or tasks.parquet."""

    def run(self) -> CommandResult:
        """Write the tables."""
        from .run_suites import table_result

        return table_result(self)


class SuiteCommand:
    """Runs a benchmark suite; `suite_commands` adds the suite's options."""

    suite: ClassVar[Suite]
    suite_name: ClassVar[str]

    def run(self) -> CommandResult:
        """Run the suite; its answer also has the suite, the command and the date, for figures."""
        from neoworld_mjx.cache import keep_compilations

        check_numbers(self)
        keep_compilations()
        function = self.suite.load()
        configured = isinstance(self, ConfiguredCommand)
        answer = function(self, self.load_config()) if configured else function(self)
        in_package = self.suite.function.startswith("neoworld_bench.")
        program = "neoworld bench run" if in_package else "python -m benchmarks"
        return {
            "suite": self.suite_name,
            "command": " ".join([program, self.suite_name, *self._changed_options()]),
            "date": datetime.date.today().isoformat(),
            **answer,
        }

    def _changed_options(self) -> Iterator[str]:
        """Spell the options out that differ from their defaults, --json last."""
        fields = dataclasses.fields(self)  # pyright: ignore[reportArgumentType]
        for field in sorted(fields, key=lambda field: field.name == "json"):
            value = getattr(self, field.name)
            if value == field.default or field.name in ("quiet", "verbose", "debug"):
                continue
            if not hasattr(field.type, "__metadata__"):  # Positional is an annotation.
                yield "--" + field.name.replace("_", "-")
            if value is not True:
                yield from map(str, value if isinstance(value, tuple) else (value,))


def suite_commands(suites: Mapping[str, Suite]) -> Any:
    """Return the union of the commands that run the suites of a table, for tyro."""
    commands = []
    for name, suite in suites.items():
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
    SuiteChoice = suite_commands(SUITES)


@dataclass(frozen=True, kw_only=True)
class BenchRunCommand:
    """Run a benchmark."""

    suite: SuiteChoice


@dataclass(frozen=True, kw_only=True)
class BenchCommand:
    """Make the benchmark, and measure methods, engines and refinement on it."""

    task: (
        Annotated[BenchRunCommand, subcommand("run")]
        | Annotated[BenchMakeCommand, subcommand("make")]
        | Annotated[BenchTableCommand, subcommand("table")]
        | Annotated[BenchChartCommand, subcommand("chart")]
    )

    @staticmethod
    def refusal(args: Sequence[str]) -> str | None:
        """Explain a suite that this command does not have; None leaves arguments to the parser."""
        if args[:1] != ["run"] or (args[1:2] and args[1] not in DEVELOPER_SUITES) or not args[1:2]:
            return None
        return (
            f"the suite {args[1]} needs a clone of the repository; there, run: "
            f"uv run python -m benchmarks {' '.join(args[1:])}"
        )

    @property
    def inner(self) -> Any:
        """The command at the end of the nested ones."""
        return self.task.suite if isinstance(self.task, BenchRunCommand) else self.task

    @property
    def json(self) -> bool:
        """See Command."""
        return self.inner.json

    @property
    def quiet(self) -> bool:
        """See Command."""
        return self.inner.quiet

    @property
    def verbose(self) -> bool:
        """See Command."""
        return self.inner.verbose

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return bench_lines(result)

    def run(self) -> CommandResult:
        """Run the suite, or draw the chart."""
        return self.inner.run()

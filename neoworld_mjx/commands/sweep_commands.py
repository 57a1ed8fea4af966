"""Commands `sweep` and `ablate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from tyro.conf import Positional

from ..errors import ConfigError
from ..machines import Machines
from .base_command import Command, CommandResult
from .result_lines import sweep_lines

if TYPE_CHECKING:
    from ..sweeps.run import SweepResult


@dataclass(frozen=True, kw_only=True)
class PlanCommand(Command, Machines):
    """Options of the commands that run a plan."""

    inputs: ClassVar = ("plan",)

    plan: Positional[Path]
    """YAML file of scenes, base options, seeds, and axes or variants."""
    out: Path
    """Folder for results.parquet, table.md, figure.svg and sweep.json; new or empty."""
    resume: bool = False
    """Continue the sweep in --out."""
    overwrite: bool = False
    """Replace the sweep in --out."""
    shard: str | None = None
    """K/N computes only the K-th of N shares of the runs. Each share needs a different --out;
    `neoworld sweep merge` joins the folders."""

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return sweep_lines(result)

    def _arguments(self) -> dict[str, Any]:
        from ..cache import keep_compilations

        keep_compilations()
        return {
            "resume": self.resume,
            "overwrite": self.overwrite,
            "machines": self.machines,
            "shard": (1, 1) if self.shard is None else shard_of(self.shard),
        }


def shard_of(text: str) -> tuple[int, int]:
    """Return the numbers K and N of a shard K/N.

    Raises:
        ConfigError: the text does not have this form.
    """
    number, slash, of = text.partition("/")
    if not (slash and number.isdecimal() and of.isdecimal()):
        raise ConfigError(f"--shard takes K/N, such as 2/4, got {text!r}")
    return int(number), int(of)


@dataclass(frozen=True, kw_only=True)
class MergeCommand(Command):
    """Join the folders of the shards of a sweep or ablation, and write its table and figure."""

    folders: Positional[tuple[Path, ...]]
    """Folders of the shards."""
    out: Path
    """Folder for the merged files; new or empty."""
    overwrite: bool = False
    """Replace the sweep in --out."""

    def run(self) -> CommandResult:
        """Merge the folders."""
        from ..sweeps import merge

        result = merge(self.folders, self.out, overwrite=self.overwrite)
        return _summary(result, self.out) | {"missing": result.about["missing"]}

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        missing = result["missing"]
        notice = [f"{missing} runs are missing: complete the shards, or sweep with --resume"]
        return [*sweep_lines(result), *(notice if missing else [])]


@dataclass(frozen=True, kw_only=True)
class SweepCommand(PlanCommand):
    """Refine scenes with all combinations of the values of some options, and with several seeds.

    `neoworld sweep merge DIR... --out DIR` joins the folders of shards.
    """

    verbs: ClassVar[dict[str, type]] = {"merge": MergeCommand}

    def run(self) -> CommandResult:
        """Run the sweep."""
        from ..sweeps import sweep

        return _summary(sweep(self.plan, self.out, **self._arguments()), self.out)


@dataclass(frozen=True, kw_only=True)
class AblateCommand(PlanCommand):
    """Refine scenes with base options and named variants, and list the differences.

    `neoworld ablate merge DIR... --out DIR` joins the folders of shards.
    """

    verbs: ClassVar[dict[str, type]] = {"merge": MergeCommand}

    def run(self) -> CommandResult:
        """Run the ablation."""
        from ..sweeps import ablate

        return _summary(ablate(self.plan, self.out, **self._arguments()), self.out)


def _summary(result: "SweepResult", out: Path) -> CommandResult:
    from ..sweeps.folder import TABLE
    from ..sweeps.result import flat

    return {
        "folder": str(out),
        "table": str(out / TABLE),
        "figure": result.about.get("figure"),
        "runs": len(result.rows),
        "seconds": result.about["seconds"],
        "points": flat(result.points),
        **({"differences": flat(result.differences)} if result.differences else {}),
    }

"""Commands of sweeps and ablations."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from .base_command import Command, CommandResult
from .result_lines import sweep_lines

if TYPE_CHECKING:
    from ..sweeps.cases import Source
    from ..sweeps.run import SweepResult

SCENE_SOURCES = "neoworld_bench.named_scenes:SOURCES"
"""Location of the sources of named scenes, which plans use as KIND:NAME."""


@dataclass(frozen=True, kw_only=True)
class PlanCommand(Command):
    """Options of the commands that run a plan."""

    plan: Positional[Path]
    """YAML file of scenes, base options, seeds, and axes or variants."""
    out: Path
    """Folder for results.parquet, table.md and sweep.json; new or empty."""
    resume: bool = False
    """Continue the sweep in --out."""
    overwrite: bool = False
    """Replace the sweep in --out."""

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return sweep_lines(result)

    def _arguments(self) -> dict[str, Any]:
        from ..cache import keep_compilations

        keep_compilations()
        module, name = SCENE_SOURCES.split(":")
        sources: dict[str, Source] = getattr(import_module(module), name)
        return {"sources": sources, "resume": self.resume, "overwrite": self.overwrite}


@dataclass(frozen=True, kw_only=True)
class SweepCommand(PlanCommand):
    """Refine scenes with every combination of some options' values and several seeds."""

    def run(self) -> CommandResult:
        """Run the sweep."""
        from ..sweeps import sweep

        return _summary(sweep(self.plan, self.out, **self._arguments()), self.out)


@dataclass(frozen=True, kw_only=True)
class AblateCommand(PlanCommand):
    """Refine scenes with base options and named variants, and list the differences."""

    def run(self) -> CommandResult:
        """Run the ablation."""
        from ..sweeps import ablate

        return _summary(ablate(self.plan, self.out, **self._arguments()), self.out)


def _summary(result: "SweepResult", out: Path) -> CommandResult:
    from ..sweeps.folder import TABLE
    from ..sweeps.table import flat

    names = ("seconds", "compile_s", "compilations", "static", "mllm")
    return {
        "folder": str(out),
        "table": str(out / TABLE),
        "figure": result.about.get("figure"),
        "runs": len(result.rows),
        **{name: result.about[name] for name in names if name in result.about},
        "points": flat(result.points),
        **({"differences": flat(result.differences)} if result.differences else {}),
    }

"""Commands that refine scenes many times: sweep, ablate."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from .base_command import Command, CommandResult
from .result_lines import sweep_lines

if TYPE_CHECKING:
    from ..sweeps.cases import Source

SCENE_SOURCES = "neoworld_bench.named_scenes:SOURCES"
"""Location of the named scenes that a plan can use as KIND:NAME."""


@dataclass(frozen=True, kw_only=True)
class PlanCommand(Command):
    """What running any plan takes."""

    plan: Positional[Path]
    """YAML that names scenes, base options, seeds, and the axes or variants."""
    out: Path
    """Folder to write results.parquet, table.md and sweep.json into; a new or empty one."""
    resume: bool = False
    """Go on with the runs in --out: keep those that are there."""
    overwrite: bool = False
    """Replace the runs in --out."""

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return sweep_lines(result)


@dataclass(frozen=True, kw_only=True)
class SweepCommand(PlanCommand):
    """Refine scenes with every combination of some options' values, with several seeds."""

    def run(self) -> CommandResult:
        """Run the sweep."""
        return _run_plan(self, ablation=False)


@dataclass(frozen=True, kw_only=True)
class AblateCommand(PlanCommand):
    """Refine scenes with a base and named changes of it, and list their differences."""

    def run(self) -> CommandResult:
        """Run the ablation."""
        return _run_plan(self, ablation=True)


def _run_plan(command: PlanCommand, *, ablation: bool) -> CommandResult:
    from ..cache import keep_compilations
    from ..sweeps import ablate, answer, sweep

    keep_compilations()
    result = (ablate if ablation else sweep)(
        command.plan,
        command.out,
        sources=_scene_sources(),
        resume=command.resume,
        overwrite=command.overwrite,
    )
    return answer(result, command.out)


def _scene_sources() -> "dict[str, Source]":
    module, name = SCENE_SOURCES.split(":")
    return getattr(import_module(module), name)

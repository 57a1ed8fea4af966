"""Commands that refine scenes many times: sweep, ablate."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from .answer_lines import sweep_lines
from .base_command import Answer, Command


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

    def lines(self, answer: Answer) -> list[str]:
        """Return the answer in few lines."""
        return sweep_lines(answer)


@dataclass(frozen=True, kw_only=True)
class SweepCommand(PlanCommand):
    """Refine scenes with every combination of some options' values, with several seeds."""

    def run(self) -> Answer:
        """Run the sweep."""
        return _run_plan(self, ablation=False)


@dataclass(frozen=True, kw_only=True)
class AblateCommand(PlanCommand):
    """Refine scenes with a base and named changes of it, and list their differences."""

    def run(self) -> Answer:
        """Run the ablation."""
        return _run_plan(self, ablation=True)


def _run_plan(command: PlanCommand, *, ablation: bool) -> Answer:
    from ..bench.named import named
    from ..cache import keep_compilations
    from ..sweeps import Case, ablate, answer, sweep

    keep_compilations()
    result = (ablate if ablation else sweep)(
        command.plan,
        command.out,
        sources={
            kind: lambda name, make=make: Case(**make(name)) for kind, make in named().items()
        },
        resume=command.resume,
        overwrite=command.overwrite,
    )
    return answer(result, command.out)

"""Commands that refine scenes many times: sweep, ablate."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from .answer_lines import sweep_lines
from .base_command import Answer, Command

if TYPE_CHECKING:
    from ..physics.layout import Layout
    from ..physics.model import SceneModel
    from ..sweeps import Case


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
    sources = {kind: lambda name, make=make: Case(**make(name)) for kind, make in named().items()}
    result = (ablate if ablation else sweep)(
        command.plan,
        command.out,
        sources=sources | {"photo": photographed},
        resume=command.resume,
        overwrite=command.overwrite,
    )
    return answer(result, command.out)


def photographed(name: str) -> "Case":
    """Return the composed scene of a bundled example, with its photograph.

    Raises:
        SpecError: no such example has one.
    """
    from ..bench.real_scenes import FOLDER
    from ..errors import SpecError, choices
    from ..pipeline.bundled_examples import bundled_examples
    from ..spec import read_scene
    from ..sweeps import Case

    examples = bundled_examples()
    composed = {each: FOLDER / f"{each}.json" for each in examples}
    known = [each for each, path in composed.items() if path.is_file()]
    if name not in known:
        raise SpecError(f"scene photo:{name}: {choices(name, known)}")
    scene, photo = read_scene(composed[name]), examples[name].photo
    return Case(f"photo:{name}", scene, errors=_box_iou, photo=photo)


def _box_iou(model: "SceneModel", layout: "Layout") -> dict[str, float]:
    """Compare the visible boxes of a layout, pop axis of length 1, with those of the photograph."""
    import numpy as np

    from ..measure import visible_box_iou

    ious = visible_box_iou(model.apply(layout, 0))
    return {"box_iou": float(np.mean(list(ious.values())))} if ious else {}

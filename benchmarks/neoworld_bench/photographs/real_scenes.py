"""Time of the search on the composed scenes of five photographs."""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from neoworld_mjx.cache import compilations
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import EngineError, choices
from neoworld_mjx.measure import visible_box_iou
from neoworld_mjx.physics.engine import open_engine
from neoworld_mjx.refinement.scene_refinement import refine
from neoworld_mjx.spec import SceneSpec, read_scene

from ..engines.table_scenes import crowded
from ..rows import Row

FOLDER = Path(__file__).parent / "real"
REAL = ("coffee", "posecnn_3", "rt1_move_near", "gemini_spill", "moge_office")
"""Scenes in `real/`, whose README names their photographs."""


class RealRow(Row):
    """One scene."""

    name: str
    objects: int
    movable: int
    """Objects that the search may move."""
    valid: bool
    """True if the result passes the final check."""
    kept: int
    """Number of objects that were already stable and stayed in place."""
    first_s: float
    """Time of the first search of the scene, in a process that has searched another one."""
    again_s: float
    """Time of a second search."""
    programs: int
    """XLA programs compiled or read from the cache in the first search."""
    rollouts: int
    rollouts_per_s: float | None
    """Rollout rate of the second search; None if too short to measure."""
    iterations: int
    mean_shift_m: float
    box_iou_before: float | None
    """Mean IoU of visible boxes with the photograph's, of the composed scene."""
    box_iou_after: float | None


def real_refinements(
    scenes: Sequence[str] = (),
    *,
    seed: int = 0,
    options: RefineOptions | None = None,
    engine: str = "native",
) -> Iterator[RealRow]:
    """Search the scenes of photographs; yield a row for each.

    Args:
        scenes: names in REAL; all by default.
        seed: of the searches.
        options: of the refinement.
        engine: that rolls candidates out.

    Raises:
        EngineError: there is no such scene, or the engine cannot run here.
    """
    scenes = chosen_photographs(scenes)
    o = options or RefineOptions()
    # `refine` itself knows where `auto` is the CPU's cores.
    runner = engine if engine == "auto" else open_engine(engine)
    compilations()
    # Another scene first: what every scene of its bucket shares is compiled here.
    refine(crowded(3), o, seed=seed, engine=runner)
    for name in scenes:
        scene = read_scene(FOLDER / f"{name}.json")
        before, began = compilations(), time.perf_counter()
        refine(scene, o, seed=seed, engine=runner)
        first, programs = time.perf_counter() - began, compilations() - before
        began = time.perf_counter()
        refined = refine(scene, o, seed=seed, engine=runner)
        again = time.perf_counter() - began
        spent = refined.seconds["rollout"]
        yield RealRow(
            name=name,
            objects=len(scene.objects),
            movable=int(np.sum([not item.environment for item in scene.objects])),
            valid=refined.passed,
            kept=len(refined.kept),
            first_s=first,
            again_s=again,
            programs=programs,
            rollouts=refined.rollouts,
            rollouts_per_s=refined.rollouts / spent if spent > 1e-3 else None,
            iterations=refined.iterations,
            mean_shift_m=refined.mean_shift_m,
            box_iou_before=_mean_iou(scene),
            box_iou_after=_mean_iou(refined.scene),
        )


def chosen_photographs(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names, all if there are none; raise an EngineError if a scene is unknown."""
    for name in names:
        if name not in REAL:
            raise EngineError(f"scene: {choices(name, list(REAL))}")
    return tuple(names or REAL)


def _mean_iou(scene: SceneSpec) -> float | None:
    values = list(visible_box_iou(scene).values())
    return float(np.mean(values)) if values else None

"""Runs of one group of points on one scene: searched together, or refined one by one."""

import json
from collections.abc import Sequence
from typing import Any

from ..compilations import compiled
from ..config import RefineOptions, option_values
from ..physics.engine import Engine
from ..physics.model import SceneModel
from ..refinement.loop import search
from ..refinement.scene_refinement import refine
from ..refinement.search_run import SearchRun
from .cases import Case
from .grouping import TRACED
from .model_scores import ModelScores, scored_by_model
from .plan import Point
from .run_rows import Row, iteration_rows, row_of_refined, row_of_search, summaries
from .winners import winners


def search_together(
    case: Case,
    compile_options: RefineOptions,
    model: SceneModel,
    runs: Sequence[SearchRun],
    engine: Engine,
) -> list[Row]:
    """Search all runs in one computation."""
    clock: dict[str, float] = {}
    before = compiled().seconds
    results = search(model, runs, engine, keep=False, clock=clock)
    seconds = max(clock["search"] - (compiled().seconds - before), 0.0) / len(runs)
    shared = {"seconds": seconds, "to_valid_s": None, "engine": engine.name}
    chosen = winners(case.scene, compile_options, model, results)
    return [
        row_of_search(case, model, result, winner)
        | shared
        | {"history": iteration_rows(result.summaries)}
        for result, winner in zip(results, chosen, strict=True)
    ]


def refine_separately(
    case: Case,
    model: SceneModel,
    runs: Sequence[tuple[Point, SearchRun]],
    engine: Engine,
    compiled_kinds: set[str],
    scores: ModelScores | None,
) -> list[Row]:
    """Refine runs one by one; the first of each kind runs twice to exclude compilation from times.

    The warm-up run uses geometric scores, which cost no model calls.

    Args:
        case: the scene.
        model: the compiled scene.
        runs: points and their runs.
        engine: the physics engine.
        compiled_kinds: static options of the runs that have been compiled; updated in place.
        scores: scores by a model; None if no run needs them.
    """
    rows = []
    for point, run in runs:
        static = {name: v for name, v in option_values(run.options).items() if name not in TRACED}
        kind = json.dumps([static, list(run.options.reward.terms)], sort_keys=True)
        if kind not in compiled_kinds:
            compiled_kinds.add(kind)
            semantic = run.options.semantic.model_copy(update={"scorer": "geometric"})
            unscored = run.options.model_copy(update={"semantic": semantic})
            refine(model, unscored, seed=run.seed, start=run.start, engine=engine)
        scoring: dict[str, Any] = {}
        if scores is not None and scored_by_model(run.options):
            scoring = scores.refine_arguments(case, point.label, run.seed)
        refined = refine(
            model, run.options, seed=run.seed, start=run.start, engine=engine, **scoring
        )
        if scores is not None:
            scores.refuse_partial(refined, case, point.label, run.seed)
        history = iteration_rows(summaries(refined.history))
        rows.append(row_of_refined(case, model, refined) | {"history": history})
    return rows

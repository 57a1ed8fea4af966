"""Runs of one group of points on one scene: searched together, or refined one by one."""

import json
import os
import time
from collections.abc import Sequence
from typing import Any

from ..compilations import compiled
from ..config import RefineOptions, option_values
from ..physics.engine import Engine
from ..physics.model import SceneModel
from ..refinement.batching import TILE
from ..refinement.delivery import delivered
from ..refinement.loop import search
from ..refinement.scene_refinement import refine
from ..refinement.search_run import SearchRun
from ..traces import computes_on_cpu
from .cases import Case
from .grouping import TRACED, holding_part
from .model_scores import ModelScores, scored_by_model
from .plan import Point
from .run_rows import Row, iteration_rows, row_of_refined, row_of_search, summaries
from .winners import winners

CANDIDATES_AT_ONCE = 1024
"""Candidates that occupy four cores for a while."""


def search_together(
    case: Case,
    compile_options: RefineOptions,
    model: SceneModel,
    runs: Sequence[SearchRun],
    engine: Engine,
    clock: dict[str, float] | None = None,
) -> list[Row]:
    """Search all runs in one computation, or in one for each set of held objects.

    On a CPU, a row does not depend on the other runs.

    Args:
        case: the scene.
        compile_options: options that the scene was compiled with.
        model: the compiled scene.
        runs: runs that share static options.
        engine: the physics engine.
        clock: seconds spent, by step; updated in place.
    """
    clock = {} if clock is None else clock
    alike: dict[str, list[int]] = {}
    for k, run in enumerate(runs):
        alike.setdefault(holding_part(run.options), []).append(k)
    rows: list[Row] = [{}] * len(runs)
    for members in alike.values():
        before = compiled().seconds
        own = [runs[k] for k in members]
        results = search(model, own, engine, keep=False, clock=clock)
        seconds = max(clock["search"] - (compiled().seconds - before), 0.0) / len(own)
        shared = {"seconds": seconds, "to_valid_s": None, "engine": engine.name}
        began = time.perf_counter()
        chosen = winners(case.scene, compile_options, model, results)
        checked = time.perf_counter()
        values_of_runs = delivered(results, chosen, engine)
        clock["check"] = clock.get("check", 0.0) + checked - began
        clock["deliver"] = clock.get("deliver", 0.0) + time.perf_counter() - checked
        for k, result, winner, values in zip(members, results, chosen, values_of_runs, strict=True):
            row = row_of_search(case, model, result, winner, values)
            rows[k] = row | shared | {"history": iteration_rows(result.summaries)}
    return rows


def runs_at_once(options: RefineOptions) -> int:
    """Return the number of runs that share a computation before their rows are saved.

    A killed sweep loses these rows at most. They are enough to occupy an engine.
    """
    candidates = CANDIDATES_AT_ONCE * max(1, (os.cpu_count() or 1) // 4)
    if not computes_on_cpu():
        candidates = max(candidates, 4 * TILE)
    return max(1, candidates // options.cem.population)


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

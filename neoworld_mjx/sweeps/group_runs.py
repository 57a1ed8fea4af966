"""Runs of one group of points on one scene, which are searched together or refined one by one.

`compute` is the task that a sweep runs in this process, or in a worker on this or another machine.
"""

import json
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ..cache import computes_on_cpu
from ..compilations import compiled
from ..config import RefineOptions, option_values
from ..parse.photo import load_photo
from ..physics.engine import Engine
from ..physics.model import SceneModel
from ..physics.native import NativeEngine
from ..physics.simulate import open_engine
from ..refinement.batching import TILE
from ..refinement.compiling import S_PHOTO, compile_for_search, reach_of, with_evidence
from ..refinement.delivery import final_scene_scores
from ..refinement.loop import search
from ..refinement.scene_refinement import refine
from ..refinement.search_run import SearchRun
from .cases import Case
from .grouping import TRACED, fixing_key
from .model_scores import ModelScores, scored_by_model
from .plan import Point
from .run_rows import Row, iteration_rows, row_of_refined, row_of_search, summaries
from .winners import winners

CANDIDATES_AT_ONCE = 1024
"""Number of candidates that keeps four cores busy long enough."""


class SweepPart(NamedTuple):
    """Runs of one group on one scene that are computed and saved together."""

    case: Case
    scene_hash: str
    options: RefineOptions
    """Options with which the scene is compiled."""
    runs: tuple[tuple[Point, int], ...]
    """Point and seed of each run."""
    together: bool
    """If True, the runs are searched together; if False, they are refined one by one."""
    engine: Engine | None
    """Physics engine. If None, the engine that the options name is opened."""
    threads: int = 0
    """Number of threads of the engine if it is opened and runs on the CPU; 0 uses all cores."""


class ComputedPart(NamedTuple):
    """Rows of the runs of a part."""

    part: SweepPart
    rows: list[Row]
    """One row per run, in the order of `part.runs`."""
    timing: dict[str, Any]
    """Entry of the part under "groups" in sweep.json."""


@dataclass
class CompiledScene:
    """Compiled models of the last scene, which later parts of a sweep in this process reuse."""

    scene_hash: str = ""
    models: dict[tuple[float, int, float, bool], SceneModel] = field(default_factory=dict)
    """Compiled models by time step, number of samples, reach, and whether the model contains the
    evidence of the photograph."""
    compiled_static: set[str] = field(default_factory=set)
    """Static options, as JSON, for which a search has been compiled."""


COMPILED = CompiledScene()


def forget_compiled(scene_hash: str = "") -> None:
    """Discard the compiled models, before another scene or another sweep."""
    COMPILED.scene_hash = scene_hash
    COMPILED.models.clear()
    COMPILED.compiled_static.clear()


def compute(part: SweepPart, scores: ModelScores | None = None) -> Iterator[ComputedPart]:
    """Compute the runs of a part, and yield their rows.

    Args:
        part: the runs.
        scores: source of scores by a model; None if no run needs such scores.
    """
    case, options = part.case, part.options
    if COMPILED.scene_hash != part.scene_hash:
        forget_compiled(part.scene_hash)
    engine = part.engine or open_engine(options.rollout.engine)
    if part.engine is None and isinstance(engine, NativeEngine):
        engine.threads = part.threads
    start, before = time.perf_counter(), compiled()
    rollout, by_photo = options.rollout, S_PHOTO in options.reward.terms
    shape = (rollout.timestep_s, rollout.samples_per_object, reach_of(options), by_photo)
    if shape not in COMPILED.models:
        model = compile_for_search(case.scene, options)
        photo = load_photo(case.photo).rgb if by_photo and case.photo is not None else None
        COMPILED.models[shape] = with_evidence(model, options, photo)
    model = COMPILED.models[shape]
    runs = [
        SearchRun(point.options, seed, None if case.start is None else case.start(model, seed))
        for point, seed in part.runs
    ]
    clock: dict[str, float] = {}
    if part.together:
        rows = search_together(case, options, model, runs, engine, clock)
    else:
        pairs = [(point, run) for (point, _), run in zip(part.runs, runs, strict=True)]
        rows = refine_separately(case, model, pairs, engine, COMPILED.compiled_static, scores)
    programs, compile_s = (a - b for a, b in zip(compiled(), before, strict=True))
    timing = {
        "scene": case.name,
        "points": list(dict.fromkeys(point.label for point, _ in part.runs)),
        "runs": len(part.runs),
        "seconds": time.perf_counter() - start,
        "compilations": int(programs),
        "compile_s": compile_s,
        "parts": clock,
    }
    yield ComputedPart(part, rows, timing)


def search_together(
    case: Case,
    compile_options: RefineOptions,
    model: SceneModel,
    runs: Sequence[SearchRun],
    engine: Engine,
    clock: dict[str, float] | None = None,
) -> list[Row]:
    """Search all runs in one computation.

    Runs that may fix different objects (see `grouping.fixing_key`) are searched in separate
    computations. On a CPU, a row does not depend on the other runs.

    Args:
        case: the scene.
        compile_options: options with which the scene was compiled.
        model: the compiled scene.
        runs: runs whose static options are equal.
        engine: the physics engine.
        clock: seconds spent on each step; updated in place.
    """
    clock = {} if clock is None else clock
    by_fixing_key: dict[str, list[int]] = {}
    for k, run in enumerate(runs):
        by_fixing_key.setdefault(fixing_key(run.options), []).append(k)
    rows: list[Row] = [{}] * len(runs)
    for members in by_fixing_key.values():
        before = compiled().seconds
        group = [runs[k] for k in members]
        results = search(model, group, engine, keep_all=False, clock=clock)
        seconds = max(clock["search"] - (compiled().seconds - before), 0.0) / len(group)
        shared = {"seconds": seconds, "to_valid_s": None, "engine": engine.name}
        began = time.perf_counter()
        chosen = winners(case.scene, compile_options, model, results)
        checked = time.perf_counter()
        values_of_runs = final_scene_scores(results, chosen, engine)
        clock["check"] = clock.get("check", 0.0) + checked - began
        clock["deliver"] = clock.get("deliver", 0.0) + time.perf_counter() - checked
        for k, result, winner, values in zip(members, results, chosen, values_of_runs, strict=True):
            row = row_of_search(case, model, result, winner, values)
            rows[k] = row | shared | {"history": iteration_rows(result.summaries)}
    return rows


def runs_at_once(options: RefineOptions) -> int:
    """Return the number of runs that are computed together, before their rows are saved.

    The number is large enough to keep an engine busy. A sweep that is killed loses at most this
    number of rows.
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
    compiled_static: set[str],
    scores: ModelScores | None,
) -> list[Row]:
    """Refine runs one by one, and exclude compilation from their times.

    For this purpose, the first run with given static options runs twice. Its warm-up run uses the
    geometric S_sem, so it sends no requests to a model.

    Args:
        case: the scene.
        model: the compiled scene.
        runs: point and inputs of each run.
        engine: the physics engine.
        compiled_static: static options, as JSON, for which a search has been compiled; updated in
            place.
        scores: source of scores by a model; None if no run needs such scores.
    """
    rows = []
    for point, run in runs:
        static = {name: v for name, v in option_values(run.options).items() if name not in TRACED}
        static_json = json.dumps([static, list(run.options.reward.terms)], sort_keys=True)
        if static_json not in compiled_static:
            compiled_static.add(static_json)
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

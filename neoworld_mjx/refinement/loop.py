"""The loop of Algorithm 1, over one run or many.

The host measures time, reports progress, settles and rolls out candidates, and requests scores from
a model. The pure functions of `algorithm` and `objective` do everything else. A refinement is this
loop over one run; a sweep is this loop over many runs.

On accelerators the functions are mapped over runs by `vmap`, in tiles. On a CPU a tile is a single
run, because `vmap` would not be faster. All results on a CPU are bit-identical to those of separate
refinements.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ..config import RefineOptions
from ..physics.engine import Engine
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.scene_arrays import on_device, pad_objects, pad_scene
from ..progress import update as update_progress
from .algorithm import converged, init, open_problem, propose, update
from .batching import map_runs, tile_size
from .compiling import compile_for_search
from .evaluation import Evaluation
from .finishing import Finished, finish, with_resting_fixed
from .objective import (
    Scores,
    has_builtin_terms_only,
    open_objective,
    refuse_not_finite,
    try_terms,
)
from .optimizer import Optimizer
from .outcome import Iteration, summarize
from .rewards import Term
from .scorer import ScoreSource, SemanticScorer
from .search_run import SearchResult, SearchRun, TimeToValid

PADDED_OPTIMIZERS = ("cem", "random")
"""Optimizers that accept a padded scene."""
CLOCKS = ("propose", "settle", "rollout", "score", "wait")
"""Steps of a search whose time is measured."""


def search(
    scene: SceneModel,
    runs: Sequence[SearchRun],
    engine: Engine,
    *,
    terms: Sequence[Term] = (),
    optimizer: Optimizer | None = None,
    scorer: SemanticScorer | None = None,
    clock: dict[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
    on_iteration: Callable[[Iteration], bool | None] | None = None,
) -> list[SearchResult]:
    """Run Algorithm 1 for all runs at once, without the final check of the winners.

    The initial layout of each run is settled and checked first. If it passes, the run ends with it,
    unless there are user-defined terms, another optimizer or a scorer.

    Args:
        scene: the compiled scene.
        runs: the runs. Their options may differ only in traced values and in values that the host
            uses.
        engine: physics engine of the rollouts.
        terms: reward terms in addition to those that the options name.
        optimizer: replaces the optimizer that the options name.
        scorer: source of S_sem by a model; only for a single run.
        clock: seconds spent on each step; updated in place.
        progress: called with one line per run and iteration.
        on_iteration: called after each iteration of each run, which ends if it returns True.

    Raises:
        ConfigError: two options contradict each other, or a reward term is invalid or not finite.
    """
    clock = {} if clock is None else clock
    clock |= dict.fromkeys(CLOCKS, 0.0) | clock
    began = time.perf_counter()
    o = runs[0].options
    objective = open_objective(o, terms=terms)
    try_terms(scene, objective, o)
    initials = _initial_scenes(scene, runs, progress)
    builtin_only = optimizer is None and scorer is None and has_builtin_terms_only(objective)
    searched = _scene_to_search(scene, runs, initials) if builtin_only else scene
    padded = pad_scene(searched)
    use_padded = objective.padded and optimizer is None and o.optimizer in PADDED_OPTIMIZERS
    arrays = padded if use_padded else searched
    tile = tile_size(len(runs), o.cem.population)
    evaluation = Evaluation(searched, arrays, padded, engine, o, len(runs), tile, clock, began)
    results = _initialize_runs(
        evaluation, runs, initials, terms, optimizer, builtin_only=builtin_only
    )
    if on_iteration is not None and o.settle.enabled:
        for r in results:
            r.finished |= bool(on_iteration(summarize(0, r.rounds[0].scores)))
    for t in range(max(run.options.cem.iterations for run in runs)):
        active = [r for r in results if t < r.run.options.cem.iterations and not r.finished]
        if not active:
            break
        layouts = _propose(evaluation, active)
        placed = evaluation.place(layouts)
        s_sem = None
        if scorer is not None:
            s_sem = _submit(evaluation, active[0], layouts[0], placed[0], scorer)
        rollouts = evaluation.roll_out(placed)
        if scorer is not None and s_sem is not None:
            s_sem = _collect(evaluation, active[0], s_sem, scorer)
        scores = evaluation.score(active, layouts, placed, rollouts, s_sem)
        rows = [(r.problem, r.state, z, s) for r, z, s in zip(active, layouts, scores, strict=True)]
        states = map_runs(update, arrays, rows, tile, o.cem.population)
        for k, (r, state) in enumerate(zip(active, states, strict=True)):
            r.state = state
            status = np.asarray(rollouts[k].status)
            refuse_not_finite(objective, scores[k], status, f"iteration {_iterations_done(r) + 1}")
            r.rounds.append(evaluation.unpadded_round(layouts[k], placed[k].poses, scores[k]))
            r.rollouts += len(scores[k].valid)
            if bool(np.any(scores[k].valid)):
                _record_first_valid(r, evaluation.began)
            if progress is not None:
                progress(_line(r, scores[k]))
            r.finished = converged(r.problem, state)
            stuck = np.flatnonzero(state.stuck)
            if len(stuck) and not bool(state.any_valid):
                r.finished, r.stuck = True, tuple(scene.names[k] for k in stuck)
            if on_iteration is not None:
                r.finished |= bool(on_iteration(summarize(_iterations_done(r), scores[k])))
        _update_progress(results, runs, began)
    clock["search"] = time.perf_counter() - began
    return results


def _initial_scenes(
    scene: SceneModel, runs: Sequence[SearchRun], progress: Callable[[str], None] | None
) -> list[Finished]:
    """Return the final scene of every run's initial layout.

    Runs whose initial layouts and options of the check are equal share one final scene.
    """
    finished: dict[Any, Finished] = {}
    initials = []
    for run in runs:
        o = run.options
        start = Layout.zero(1, len(scene.names)) if run.start is None else run.start
        key = (o.max_depth_m, o.max_drift_m, o.max_tilt_deg, o.check_duration_s, o.check_timestep_s)
        key += tuple(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(start))
        if key not in finished:
            finished[key] = finish(scene, start, 0, o)
            if progress is not None:
                progress(_initial_line(scene, finished[key], o))
        initials.append(finished[key])
    return initials


def _scene_to_search(
    scene: SceneModel, runs: Sequence[SearchRun], initials: Sequence[Finished]
) -> SceneModel:
    """Return the scene to search, in which resting objects are fixed if this suits all runs."""
    first = initials[0]
    shared = all(run.start is None and run.options.cem.hold_resting for run in runs)
    shared &= all(initial is first for initial in initials)
    o = runs[0].options
    if not shared or first.passed or not first.rests(o).any():
        return scene
    searched = compile_for_search(with_resting_fixed(scene.spec, first, o), o)
    return dataclasses.replace(searched, photo=scene.photo)


def _initialize_runs(
    evaluation: Evaluation,
    runs: Sequence[SearchRun],
    initials: Sequence[Finished],
    terms: Sequence[Term],
    optimizer: Optimizer | None,
    *,
    builtin_only: bool,
) -> list[SearchResult]:
    """Initialize every run. With settling, the initial layout is its first iteration.

    If `builtin_only` is False (user-defined terms, another optimizer or scores by a model), every
    object moves, and a scene that passes the final check is searched, too.
    """
    scene, arrays, padded = evaluation.scene, evaluation.arrays, evaluation.padded
    results = []
    for run, initial in zip(runs, initials, strict=True):
        o = run.options
        start = Layout.zero(1, len(scene.names)) if run.start is None else run.start
        origin = on_device(pad_objects(start, arrays.count))
        problem = open_problem(arrays, o, origin, terms=terms, optimizer=optimizer)
        factor = _initial_factors(arrays.count, initial, o.cem.hold_resting and builtin_only, o)
        state = init(problem, run.seed, factor)
        result = SearchResult(run, problem, state, scene, arrays, padded, initial, builtin_only)
        results.append(result)
    if evaluation.options.settle.enabled:
        for result, round_ in zip(results, evaluation.score_initials(results), strict=True):
            result.rounds.append(round_)
            result.score_sources.append(np.array([ScoreSource.GEOMETRIC], np.int8))
            result.rollouts = 1
            result.finished = result.initial.passed and builtin_only
            if result.initial.passed or bool(round_.scores.valid[0]):
                _record_first_valid(result, evaluation.began)
    return results


def _record_first_valid(r: SearchResult, began: float) -> None:
    """Record the current iteration as the first one with a valid candidate, if it is the first."""
    if r.first_valid is None:
        r.first_valid = TimeToValid(_iterations_done(r), r.rollouts)
        r.first_valid_s = time.perf_counter() - began


def _initial_factors(
    count: int, initial: Finished, hold_resting: bool, o: RefineOptions
) -> Float[np.ndarray, " object"]:
    """Return the initial factor of each object's standard deviations.

    The factor is 0 for objects that rest in the initial layout if `hold_resting` is True, and else
    1.
    """
    factors = np.ones(count, np.float32)
    if hold_resting:
        rests = initial.rests(o)
        factors[: len(rests)][rests] = 0.0
    return factors


def _initial_line(scene: SceneModel, initial: Finished, o: RefineOptions) -> str:
    moving = np.asarray(scene.optimised)
    failing = [scene.names[k] for k in np.flatnonzero(moving & ~initial.rests(o))]
    if not failing:
        return f"all {int(moving.sum())} objects rest where they were placed"
    return f"{len(failing)} of {int(moving.sum())} objects do not rest: {', '.join(failing)}"


def _propose(evaluation: Evaluation, active: Sequence[SearchResult]) -> list[Layout]:
    began = time.perf_counter()
    rows = [(r.problem, r.state, r.run.options.cem.population) for r in active]
    layouts = map_runs(propose, evaluation.arrays, rows, evaluation.tile)
    evaluation.clock["propose"] += time.perf_counter() - began
    return layouts


def _submit(
    evaluation: Evaluation, r: SearchResult, layouts: Layout, placed: Any, scorer: SemanticScorer
) -> np.ndarray:
    """Submit the candidates that score best before physics; return the geometric S_sem of all."""
    before = evaluation.before_physics(r, layouts, placed)
    geometric = np.asarray(before.terms["s_sem"])
    candidates = evaluation.unpadded(layouts), evaluation.unpadded(placed.poses)
    scorer.submit(len(r.rounds), np.asarray(before.reward), geometric, *candidates)
    return geometric


def _collect(
    evaluation: Evaluation, r: SearchResult, geometric: np.ndarray, scorer: SemanticScorer
) -> np.ndarray:
    """Wait for scores by a model, and return S_sem of all candidates of an iteration."""
    began = time.perf_counter()
    scorer.collect(len(r.rounds))
    evaluation.clock["wait"] += time.perf_counter() - began
    values, sources = scorer.s_sem_of(len(r.rounds), geometric)
    r.score_sources.append(sources)
    return values


def _iterations_done(r: SearchResult) -> int:
    """Return the number of iterations so far, not counting the initial layout."""
    return len(r.rounds) - r.run.options.settle.enabled


def _line(r: SearchResult, scores: Scores) -> str:
    best = float(np.asarray(scores.absolute).max())
    return (
        f"iteration {_iterations_done(r)}/{r.run.options.cem.iterations}: best {best:.3f}, "
        f"elites {float(r.state.elite_mean):.3f}, {float(np.mean(scores.valid)):.0%} valid"
    )


def _update_progress(
    results: Sequence[SearchResult], runs: Sequence[SearchRun], began: float
) -> None:
    """Report the number of iterations, the candidates per second and the longest remaining time."""
    seconds = time.perf_counter() - began
    done = sum(map(_iterations_done, results))
    total = sum(run.options.cem.iterations for run in runs)
    candidates = sum(r.rollouts for r in results)
    update_progress(
        done=done,
        of=total,
        unit="iteration",
        rate=candidates / max(seconds, 1e-9),
        left_s=seconds / max(done, 1) * (total - done),
    )

"""The loop of Algorithm 1, over one run or many.

The host measures time, reports progress, chooses the rollouts and requests scores from a model;
the rest are the pure functions of `algorithm` and `objective`. A sweep is this loop over many runs,
a refinement over one. On accelerators the functions are mapped over runs by `vmap`, in tiles. On a
CPU a tile is one run: `vmap` would not be faster, and every number is bit-identical to that of a
separate refinement.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from ..config import RefineOptions
from ..measure import SceneMeasure
from ..physics.engine import Engine
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.scene_arrays import SceneArrays, on_device, pad_objects, pad_scene
from ..physics.simulate import on_cpu
from ..progress import update as update_progress
from ..spec import SceneSpec
from .algorithm import (
    by_gradient,
    check_credit,
    converged,
    initial_state,
    open_problem,
    projects,
    propose,
    resumed,
    update,
)
from .batching import map_runs, take, tile_of
from .cem import CEMState, elite_count, initial_sigma
from .evaluation import Evaluation
from .feasibility import (
    ITERATIONS_PER_STAGE,
    SETTLE_BATCH,
    always_falling,
    deviation_share,
    initial_summary,
    photo_mismatches,
    search_farther,
    should_settle,
    stages,
    widen_deviations,
)
from .objective import Placement, Scores, has_builtin_terms_only, open_objective, try_terms
from .optimizer import Optimizer
from .outcome import iteration_summary
from .pruning import RolloutPlan
from .rewards import Term
from .rounds import Round, best_first
from .scorer import SemanticScorer
from .search_run import SearchResult, SearchRun, bounded, population_at, prunes

PADDED = ("cem", "random")
"""Optimizers that accept a padded scene."""


def search(
    scene: SceneModel,
    runs: Sequence[SearchRun],
    engine: Engine,
    *,
    terms: Sequence[Term] = (),
    optimizer: Optimizer | None = None,
    scorer: SemanticScorer | None = None,
    keep: bool = True,
    clock: dict[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
) -> list[SearchResult]:
    """Run Algorithm 1 for all runs at once, without the exact check of the winners.

    Args:
        scene: the compiled scene.
        runs: runs whose options differ only in traced values and in options of the host.
        engine: physics engine of the rollouts.
        terms: reward terms in addition to those that the options name.
        optimizer: replaces the optimizer that the options name.
        scorer: semantic scores by a model; for a single run.
        keep: True to keep all candidates, False to keep only possible finalists.
        clock: seconds spent, by step; updated in place.
        progress: called with one line per run and iteration.

    Raises:
        ConfigError: options exclude each other, or a reward term is invalid.
    """
    clock = {} if clock is None else clock
    clock |= dict.fromkeys(("descent", "rollout", "score", "wait"), 0.0) | clock
    began = time.perf_counter()
    o = runs[0].options
    check_credit(o, terms)
    objective = open_objective(o, terms=terms)
    try_terms(scene, objective, o)
    unpadded_optimizer = optimizer is not None or o.optimizer not in PADDED
    arrays = pad_scene(scene) if objective.padded and not unpadded_optimizer else scene
    tile = tile_of(len(runs), max(o.cem.population, o.cem.first))
    evaluation = Evaluation(scene, arrays, engine, o, len(runs), tile, clock, began)
    may_fix_objects = (
        not unpadded_optimizer and scorer is None and has_builtin_terms_only(objective)
    )
    results = _opened(evaluation, runs, terms, optimizer, may_fix_objects, progress)
    for r in results:
        r.settles = should_settle(r.run.options, 0, scorer)
    live = results
    for t in range(max(run.options.cem.iterations for run in runs)):
        live = [r for r in live if t < r.run.options.cem.iterations and not r.finished]
        if not live:
            break
        layouts = _propose(arrays, live, t, tile, clock)
        pop = population_at(o, t)
        problems, rests = [r.problem for r in live], [_rests(r, pop) for r in live]
        placements = evaluation.place(problems, layouts, pop, [n > 0 for n in rests])
        layouts, placements = take((layouts, placements), slice(pop))
        plans = [_plan(*row, scorer) for row in zip(live, placements, rests, strict=True)]
        if scorer is None:
            evaluation.run_plans(live, layouts, placements, plans)
        else:
            live[0].marks.append(
                evaluation.with_scorer(live[0], layouts[0], placements[0], plans[0], scorer)
            )
        scores = [plan.scores() for plan in plans]
        rows = [(r.problem, r.state, z, s) for r, z, s in zip(live, layouts, scores, strict=True)]
        for k, (r, state) in enumerate(
            zip(live, map_runs(update, arrays, rows, tile), strict=True)
        ):
            r.state = state
            r.rollouts += plans[k].rolled_out
            r.pruned += pop - plans[k].rolled_out
            rests = np.full(pop, r.settles)
            round_ = Round(layouts[k], placements[k].poses, scores[k], rests)
            round_ = round_.of_objects(len(scene.names))
            r.rounds.append(round_ if keep else _finalists(round_, r.run.options))
            r.summaries.append(_summary(scores[k]))
            if progress is not None:
                progress(_line(r, scores[k]))
            r.finished = converged(r.problem, r.state)
            if r.finished and r.later is not None:
                _follow_photo(arrays, r, terms, clock)
            if not bool(r.state.seen_valid):
                if not r.settles and should_settle(r.run.options, len(r.rounds), scorer):
                    r.settles = True
                    r.stage_began = r.judged_from = len(r.rounds)
                elif not unpadded_optimizer:
                    _widen_proposal(arrays, scene.spec, r, terms)
        _update_progress(results, runs, began)
    clock["search"] = time.perf_counter() - began
    return results


def _update_progress(
    results: Sequence[SearchResult], runs: Sequence[SearchRun], began: float
) -> None:
    """Report the iteration, the rate of candidates and the longest remaining time."""
    seconds = time.perf_counter() - began
    done = sum(len(r.rounds) for r in results)
    total = sum(run.options.cem.iterations for run in runs)
    candidates = sum(len(round_.scores.absolute) for r in results for round_ in r.rounds)
    remaining = seconds / max(done, 1) * (total - done)
    update_progress(
        done=done,
        of=total,
        unit="iteration",
        rate=candidates / max(seconds, 1e-9),
        left_s=remaining,
    )


class _InitialScene(NamedTuple):
    """Initial state shared by runs with equal initial layouts; fields as in `SearchResult`."""

    origin: Layout
    stages: list[np.ndarray]
    share: np.ndarray | None
    later: np.ndarray | None
    first: Round | None
    checked: SceneMeasure | None


def _opened(
    evaluation: Evaluation,
    runs: Sequence[SearchRun],
    terms: Sequence[Term],
    optimizer: Optimizer | None,
    may_fix_objects: bool,
    progress: Callable[[str], None] | None,
) -> list[SearchResult]:
    """Initialize every run; runs with equal initial layouts share the evaluation of the layout."""
    # Not a vmap over layouts: its gradients round differently, and Adam amplifies that.
    initial_scenes: dict[Any, _InitialScene] = {}
    scene, results = evaluation.arrays, []
    for run in runs:
        o = run.options
        initial = Layout.zero(1, scene.count) if run.start is None else run.start
        initial = on_device(pad_objects(initial, scene.count))
        key = (o.cem.sigma_xy, o.cem.sigma_yaw_deg, o.cem.sigma_log_scale)
        key += (o.cem.sigma_agreeing, o.cem.keep_sound)
        key += (o.max_depth_m, o.max_drift_m, o.max_tilt_deg)
        key += (o.check_duration_s, o.check_timestep_s)
        key += tuple(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(initial))
        if key not in initial_scenes:
            mask, share = [np.asarray(scene.optimised)], None
            mismatched, first, checked = None, None, None
            if may_fix_objects and o.cem.keep_sound:
                first, feasibility, checked = evaluation.evaluate_initial(initial, o, terms)
                mask = stages(scene, feasibility, o.cem)
                mismatched = photo_mismatches(scene, feasibility, mask[0])
                share = deviation_share(feasibility, o.cem)
                if progress is not None:
                    progress(initial_summary(evaluation.scene.names, feasibility, mask[-1]))
            mean = _warm_start(scene, initial, mask[0], share, o, evaluation.clock)
            initial_scenes[key] = _InitialScene(mean, mask, share, mismatched, first, checked)
        mean, mask, share, mismatched, first, checked = initial_scenes[key]
        problem = open_problem(
            scene, o, mean, moves=mask[0], share=share, terms=terms, optimizer=optimizer
        )
        result = SearchResult(run, mean, problem, initial_state(problem, mean), stages=list(mask))
        result.share, result.later, result.checked = share, mismatched, checked
        if first is not None and not mask[0].any():
            # All objects are feasible: the initial layout is the result.
            result.rounds, result.rollouts, result.finished = [first], 1, True
            result.summaries = [_summary(first.scores)]
            result.first_valid_s = time.perf_counter() - evaluation.began
        results.append(result)
    return results


def _widen_proposal(
    scene: SceneArrays, spec: SceneSpec, r: SearchResult, terms: Sequence[Term]
) -> None:
    """Widen the proposal if no candidate was valid, or end the search if an object always falls."""
    recent = r.rounds[r.judged_from :]
    falling = always_falling([np.asarray(round_.scores.drift) for round_ in recent])
    if falling is not None and falling.any():
        on_support = np.asarray(scene.arrangement.snapped)[: len(falling)]
        if r.searched_farther or not (falling & on_support).any():
            r.falling, r.finished = falling, True
        else:
            # Their support may be outside the search distribution.
            r.searched_farther, r.judged_from = True, len(r.rounds)
            r.state = search_farther(r.state, r.problem.sigma, falling, spec)
        return
    if len(r.rounds) - r.stage_began < ITERATIONS_PER_STAGE or len(r.stages) < 2:
        return
    r.stages.pop(0)
    r.stage_began = len(r.rounds)
    o = r.run.options
    r.problem = open_problem(scene, o, r.origin, moves=r.stages[0], share=r.share, terms=terms)
    r.state = widen_deviations(r.state, r.problem.sigma)


def _follow_photo(
    scene: SceneArrays, r: SearchResult, terms: Sequence[Term], clock: dict[str, float]
) -> None:
    """Also move objects that disagree with the photograph, once a valid candidate is known."""
    assert r.later is not None
    o, mismatched, r.later = r.run.options, r.later, None
    if o.cem.iterations <= len(r.rounds):
        return
    moves = r.stages[0] | mismatched
    r.problem = open_problem(scene, o, r.origin, moves=moves, share=r.share, terms=terms)
    r.state = resumed(widen_deviations(r.state, r.problem.sigma))
    if isinstance(r.state.optimizer, CEMState):
        mean = _warm_start(scene, r.state.optimizer.mean, mismatched, r.share, o, clock)
        r.state = eqx.tree_at(lambda s: s.optimizer.mean, r.state, mean)
    r.finished = False


def _warm_start(
    scene: SceneArrays,
    initial: Layout,
    moves: np.ndarray,
    share: np.ndarray | None,
    o: RefineOptions,
    clock: dict[str, float],
) -> Layout:
    if not o.descent.warm_steps or not moves.any():
        return initial
    began = time.perf_counter()
    # With a single candidate, kernel launches dominate on a GPU.
    with on_cpu():
        mean = by_gradient(
            scene,
            initial,
            initial_sigma(scene, o.cem, moves, share),
            steps=o.descent.warm_steps,
            rate=o.descent.rate,
            samples=o.descent.samples,
            photo=True,
        )
    mean = on_device(jax.device_get(mean))
    clock["descent"] += time.perf_counter() - began
    return mean


def _propose(
    scene: SceneArrays, live: Sequence[SearchResult], t: int, tile: int, clock: dict[str, float]
) -> list[Layout]:
    """Propose a population for each run, projected if its options request it.

    The first iteration draws as many candidates as the others, so that one shape is compiled.
    """
    began = time.perf_counter()
    o = live[0].run.options
    d = o.descent
    projection = (d.project_steps, d.rate, d.samples)
    population = max(population_at(o, 0), population_at(o, 1))
    layouts: dict[int, Layout] = {}
    for projected in (False, True):
        rows = {
            k: (r.problem, r.state, np.asarray(r.run.seed, np.uint32), population)
            + ((projection,) if projected else (None,))
            for k, r in enumerate(live)
            # Settled candidates are projected just before settling.
            if (projects(d.project, t, r.state) and not r.settles) == projected
        }
        layouts |= zip(rows, map_runs(propose, scene, list(rows.values()), tile), strict=True)
    clock["descent"] += time.perf_counter() - began
    return [layouts[k] for k in range(len(live))]


def _plan(
    r: SearchResult, placement: Placement, rests: int, scorer: SemanticScorer | None
) -> RolloutPlan:
    c = r.run.options.cem
    pruned = prunes(r.run.options, r.problem) and scorer is None
    return RolloutPlan(
        placement,
        batch=c.batch if pruned else None,
        elites=elite_count(c.elite_ratio, len(placement.bound)),
        until_valid=c.credit == "auto" and not bool(r.state.seen_valid),
        seen_valid=bool(r.state.seen_valid),
        rests=rests,
    )


def _rests(r: SearchResult, population: int) -> int:
    """Return the number of candidates settled at once: all, if none may be left out."""
    if not r.settles:
        return 0
    return min(SETTLE_BATCH, population) if bounded(r.run.options, r.problem) else population


def _finalists(round_: Round, o: RefineOptions) -> Round:
    """Keep the candidates of an iteration that may be among the best `finalists` of all."""
    host: Round = jax.tree.map(np.asarray, round_)
    scores = host.scores
    order = best_first(*map(np.asarray, (scores.valid, scores.fidelity, scores.absolute)))
    best = order[: o.finalists]
    # Sorted, because candidates of equal reward keep the order of the population.
    return jax.tree.map(lambda x: x[np.sort(best)], host)


def _summary(scores: Scores) -> dict[str, Any]:
    host: Scores = jax.tree.map(np.asarray, scores)
    values: dict[str, Any] = {
        "absolute": host.absolute,
        "valid": host.valid,
        "status": host.status,
        **host.terms,
    }
    return iteration_summary(values, list(host.terms))


def _line(r: SearchResult, scores: Scores) -> str:
    rolled = np.isfinite(np.asarray(scores.terms["d_drift"]))
    best = float(np.asarray(scores.absolute).max())
    share = float(np.asarray(scores.valid)[rolled].mean()) if rolled.any() else 0.0
    pruned = "" if rolled.all() else f", {1 - rolled.mean():.0%} pruned"
    return (
        f"iteration {len(r.rounds)}/{r.run.options.cem.iterations}: best {best:.3f}, "
        f"elites {float(r.state.elite_mean):.3f}, {share:.0%} valid{pruned}"
    )

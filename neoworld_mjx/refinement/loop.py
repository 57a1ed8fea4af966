"""The loop of Algorithm 1, over one run or many.

The host keeps the clock, prints progress, chooses the rollouts to make and requests scores from a
model; all else are the pure functions of `algorithm` and `objective`. A sweep is this loop over
many runs, a refinement over one. On accelerators those functions are mapped over runs by `vmap`, in
tiles. On a CPU nothing is gained by that, and sums would round differently than in a refinement by
itself: there a tile is one run, and every number is that of a separate refinement, to the last bit.
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
    initial_line,
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
"""Optimizers that take a padded scene."""


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
    """Run Algorithm 1 for every run at once, without the exact check of the winners.

    Args:
        scene: the compiled scene.
        runs: whose options differ in traced ones and those of the host alone.
        engine: what rolls candidates out.
        terms: reward terms besides those that the options name.
        optimizer: in place of the one that the options name.
        scorer: semantic scores by a model, of a single run.
        keep: keep all candidates; else those of each iteration that may be finalists.
        clock: seconds spent, by step; added to.
        progress: called with one line a run and iteration.

    Raises:
        ConfigError: options that exclude each other, or a reward term that does not work.
    """
    clock = {} if clock is None else clock
    clock |= dict.fromkeys(("descent", "rollout", "score", "wait"), 0.0) | clock
    began = time.perf_counter()
    o = runs[0].options
    check_credit(o, terms)
    objective = open_objective(o, terms=terms)
    try_terms(scene, objective, o)
    own_optimizer = optimizer is not None or o.optimizer not in PADDED
    arrays = pad_scene(scene) if objective.padded and not own_optimizer else scene
    tile = tile_of(len(runs), max(o.cem.population, o.cem.first))
    evaluation = Evaluation(scene, arrays, engine, o, len(runs), tile, clock, began)
    keeps = not own_optimizer and scorer is None and has_builtin_terms_only(objective)
    results = _opened(evaluation, runs, terms, optimizer, keeps, progress)
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
        plans = [_plan(*of, scorer) for of in zip(live, placements, rests, strict=True)]
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
                elif not own_optimizer:
                    _widen_proposal(arrays, scene.spec, r, terms)
        _update_progress(results, runs, began)
    clock["search"] = time.perf_counter() - began
    return results


def _update_progress(
    results: Sequence[SearchResult], runs: Sequence[SearchRun], began: float
) -> None:
    """Report the iteration, the rate of candidates and the time that is left at most."""
    seconds = time.perf_counter() - began
    done = sum(len(r.rounds) for r in results)
    of = sum(run.options.cem.iterations for run in runs)
    candidates = sum(len(round_.scores.absolute) for r in results for round_ in r.rounds)
    left = seconds / max(done, 1) * (of - done)
    update_progress(
        done=done, of=of, unit="iteration", rate=candidates / max(seconds, 1e-9), left_s=left
    )


class _InitialScene(NamedTuple):
    """What runs that start alike share; fields as in `SearchResult`."""

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
    keeps: bool,
    progress: Callable[[str], None] | None,
) -> list[SearchResult]:
    """Open every run; those that start alike share what is known of their start."""
    # Not a vmap over starts: its gradients round differently, and Adam carries that on.
    known: dict[Any, _InitialScene] = {}
    scene, results = evaluation.arrays, []
    for run in runs:
        o = run.options
        start = Layout.zero(1, scene.count) if run.start is None else run.start
        start = on_device(pad_objects(start, scene.count))
        alike = (o.cem.sigma_xy, o.cem.sigma_yaw_deg, o.cem.sigma_log_scale)
        alike += (o.cem.sigma_agreeing, o.cem.keep_sound)
        alike += (o.max_depth_m, o.max_drift_m, o.max_tilt_deg)
        alike += (o.check_duration_s, o.check_timestep_s)
        alike += tuple(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(start))
        if alike not in known:
            mask, share = [np.asarray(scene.optimised)], None
            later, first, checked = None, None, None
            if keeps and o.cem.keep_sound:
                first, sound, checked = evaluation.evaluate_initial(start, o, terms)
                mask = stages(scene, sound, o.cem)
                later = photo_mismatches(scene, sound, mask[0])
                share = deviation_share(sound, o.cem)
                if progress is not None:
                    progress(initial_line(evaluation.scene.names, sound, mask[-1]))
            mean = _warm_start(scene, start, mask[0], share, o, evaluation.clock)
            known[alike] = _InitialScene(mean, mask, share, later, first, checked)
        mean, mask, share, later, first, checked = known[alike]
        problem = open_problem(
            scene, o, mean, moves=mask[0], share=share, terms=terms, optimizer=optimizer
        )
        result = SearchResult(run, mean, problem, initial_state(problem, mean), stages=list(mask))
        result.share, result.later, result.checked = share, later, checked
        if first is not None and not mask[0].any():
            # All is sound: the start is the answer.
            result.rounds, result.rollouts, result.finished = [first], 1, True
            result.summaries = [_summary(first.scores)]
            result.first_valid_s = time.perf_counter() - evaluation.began
        results.append(result)
    return results


def _widen_proposal(
    scene: SceneArrays, spec: SceneSpec, r: SearchResult, terms: Sequence[Term]
) -> None:
    """Let more objects move where nothing was valid, or end a search that has no hope."""
    since = r.rounds[r.judged_from :]
    falling = always_falling([np.asarray(round_.scores.drift) for round_ in since])
    if falling is not None and falling.any():
        on_support = np.asarray(scene.arrangement.snapped)[: len(falling)]
        if r.searched_farther or not (falling & on_support).any():
            r.falling, r.finished = falling, True
        else:
            # Their support may be farther than they were looked for.
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
    """Let what disagrees with the photograph move too, now that a valid candidate is known."""
    assert r.later is not None
    o, later, r.later = r.run.options, r.later, None
    if o.cem.iterations <= len(r.rounds):
        return
    moves = r.stages[0] | later
    r.problem = open_problem(scene, o, r.origin, moves=moves, share=r.share, terms=terms)
    r.state = resumed(widen_deviations(r.state, r.problem.sigma))
    if isinstance(r.state.optimizer, CEMState):
        mean = _warm_start(scene, r.state.optimizer.mean, later, r.share, o, clock)
        r.state = eqx.tree_at(lambda s: s.optimizer.mean, r.state, mean)
    r.finished = False


def _warm_start(
    scene: SceneArrays,
    start: Layout,
    moves: np.ndarray,
    share: np.ndarray | None,
    o: RefineOptions,
    clock: dict[str, float],
) -> Layout:
    if not o.descent.warm_steps or not moves.any():
        return start
    began = time.perf_counter()
    # With a single candidate a GPU does nothing but start kernels.
    with on_cpu():
        mean = by_gradient(
            scene,
            start,
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
    """Propose a population for each run, projected where its options say so.

    The first iteration, too, draws the others' number, so that one shape is compiled.
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
            # What comes to rest is projected just before that.
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
    """Return how many candidates come to rest at once: all where none may be left out."""
    if not r.settles:
        return 0
    return min(SETTLE_BATCH, population) if bounded(r.run.options, r.problem) else population


def _finalists(round_: Round, o: RefineOptions) -> Round:
    """Keep the candidates of an iteration that may be among the best `finalists` of all."""
    host: Round = jax.tree.map(np.asarray, round_)
    scores = host.scores
    order = best_first(*map(np.asarray, (scores.valid, scores.fidelity, scores.absolute)))
    best = order[: o.finalists]
    # Sorted, as equal ones are taken in the order of the population.
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

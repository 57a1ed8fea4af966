"""The loop of Algorithm 1, over one run or many.

The host keeps the clock, prints progress, chooses the rollouts to make and requests scores from a
model; all else are the pure functions of `algorithm` and `objective`. A sweep is this loop over
many runs, a refinement over one. On accelerators those functions are mapped over runs by `vmap`, in
tiles. On a CPU nothing is gained by that, and sums would round differently than in a refinement by
itself: there a tile is one run, and every number is that of a separate refinement, to the last bit.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..config import RefineOptions
from ..physics.engine import Engine, Rollout
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.simulate import on_cpu
from .algorithm import (
    Problem,
    SearchState,
    converged,
    initial_state,
    open_problem,
    propose,
    update,
)
from .batching import map_runs, roll_out, take, tile_of
from .cem import elite_count, initial_sigma
from .gradient import refine_by_gradient
from .objective import Placement, Scores, evaluate, place, try_terms
from .optimizer import Optimizer
from .outcome import Round
from .pruning import RolloutPlan
from .rewards import Term
from .scorer import SemanticScorer

FILLED = 16
"""How many times its candidates an iteration may evaluate to spare a compilation."""


class SearchRun(NamedTuple):
    """One refinement of a scene."""

    options: RefineOptions
    seed: int
    start: Layout | None = None
    """Pop axis of length 1; None is the composed scene."""


@dataclass
class SearchResult:
    """A run's search as far as it has come, before the exact check of its winner."""

    run: SearchRun
    problem: Problem
    state: SearchState
    rounds: list[Round] = field(default_factory=list)
    rollouts: int = 0
    first_valid_s: float = float("nan")
    """When the batch of the first valid candidate was scored, since the start of the search."""
    marks: list[np.ndarray] = field(default_factory=list)
    """How each S_sem came about, by iteration; see `scorer.Mark`."""


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
    for step in ("descent", "rollout", "score", "wait"):
        clock.setdefault(step, 0.0)
    began = time.perf_counter()
    results = _opened(scene, runs, clock, terms, optimizer)
    try_terms(scene, results[0].problem.objective, runs[0].options)
    o = runs[0].options
    tile = tile_of(len(runs), max(o.cem.population, o.cem.first))
    live = results
    for t in range(max(run.options.cem.iterations for run in runs)):
        live = [r for r in live if t < r.run.options.cem.iterations]
        if not live:
            break
        layouts = _propose(scene, live, t, tile, clock)
        placements = _place(scene, live, layouts, tile, clock)
        plans = [_plan(r, placement, scorer) for r, placement in zip(live, placements, strict=True)]
        evaluation = _Evaluation(scene, engine, o, len(runs), tile, clock, began)
        if scorer is None:
            evaluation.in_batches(live, layouts, placements, plans)
        else:
            live[0].marks.append(
                evaluation.with_scorer(live[0], layouts[0], placements[0], plans[0], scorer)
            )
        scores = [plan.scores() for plan in plans]
        rows = [(r.problem, r.state, z, s) for r, z, s in zip(live, layouts, scores, strict=True)]
        for k, (r, state) in enumerate(zip(live, map_runs(update, scene, rows, tile), strict=True)):
            r.state = state
            r.rollouts += plans[k].rolled_out
            round_ = Round(layouts[k], placements[k].poses, scores[k])
            r.rounds.append(round_ if keep else _finalists(round_, r.run.options))
            if progress is not None:
                progress(_line(r, scores[k]))
        live = [r for r in live if not converged(r.problem, r.state)]
    clock["search"] = time.perf_counter() - began
    return results


def population_at(options: RefineOptions, t: int) -> int:
    """Return N of an iteration; the first one may be smaller."""
    c = options.cem
    return min(c.first, c.population) if t == 0 and c.first else c.population


def prunes(options: RefineOptions, problem: Problem) -> bool:
    """Tell whether candidates that cannot become elites are left out.

    Only where every term has a bound, and elites are those of the whole scene.
    """
    fixed = options.reward.normalisation == "fixed" and options.cem.credit in ("auto", "scene")
    return options.cem.prune and fixed and not problem.objective.unbounded


def _opened(
    scene: SceneModel,
    runs: Sequence[SearchRun],
    clock: dict[str, float],
    terms: Sequence[Term],
    optimizer: Optimizer | None,
) -> list[SearchResult]:
    """Open every run; those that start alike share one gradient refinement."""
    # Not a vmap over starts: its gradients round differently, and Adam carries that on.
    known: dict[Any, Layout] = {}
    results = []
    for run in runs:
        o = run.options
        start = Layout.zero(1, len(scene.names)) if run.start is None else run.start
        start = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), start)
        alike = (o.cem.sigma_xy, o.cem.sigma_yaw_deg, o.cem.sigma_log_scale)
        alike += tuple(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(start))
        if alike not in known:
            known[alike] = _warm_start(scene, start, o, clock)
        problem = open_problem(scene, o, known[alike], terms=terms, optimizer=optimizer)
        results.append(SearchResult(run, problem, initial_state(problem, known[alike])))
    return results


def _warm_start(
    scene: SceneModel, start: Layout, o: RefineOptions, clock: dict[str, float]
) -> Layout:
    if not o.descent.warm_steps:
        return start
    began = time.perf_counter()
    # With a single candidate a GPU does nothing but start kernels.
    with on_cpu():
        mean = refine_by_gradient(
            scene,
            start,
            initial_sigma(scene, o.cem),
            steps=o.descent.warm_steps,
            rate=o.descent.rate,
            samples=o.descent.samples,
            photo=True,
        )
    mean = jax.block_until_ready(mean)
    clock["descent"] += time.perf_counter() - began
    return mean


def _propose(
    scene: SceneModel, live: Sequence[SearchResult], t: int, tile: int, clock: dict[str, float]
) -> list[Layout]:
    """Propose a population for each run, projected where its options say so."""
    began = time.perf_counter()
    o = live[0].run.options
    d = o.descent
    projection = (d.project_steps, d.rate, d.samples)
    population = population_at(o, t)
    layouts: dict[int, Layout] = {}
    for projected in (False, True):
        rows = {
            k: (r.problem, r.state, jax.random.key(r.run.seed), population)
            + ((projection,) if projected else (None,))
            for k, r in enumerate(live)
            if _projects(d.project, t, r.state) == projected
        }
        layouts |= zip(rows, map_runs(propose, scene, list(rows.values()), tile), strict=True)
    proposed = jax.block_until_ready([layouts[k] for k in range(len(live))])
    clock["descent"] += time.perf_counter() - began
    return proposed


def _projects(option: str, t: int, state: SearchState) -> bool:
    needed = option == "needed" and t > 0 and not bool(state.seen_valid)
    return option == "always" or needed


def _place(
    scene: SceneModel,
    live: Sequence[SearchResult],
    layouts: Sequence[Layout],
    tile: int,
    clock: dict[str, float],
) -> list[Placement]:
    """Place the populations; a smaller first one is filled up to the others', to compile once."""
    began = time.perf_counter()
    pop, most = layouts[0].yaw.shape[0], live[0].run.options.cem.population
    filled = pop < most <= FILLED * pop
    if filled:
        fill = lambda x: np.resize(np.asarray(x), (most, *x.shape[1:]))
        layouts = [jax.tree.map(fill, z) for z in layouts]
    rows = [(z, r.problem.objective.bounded) for r, z in zip(live, layouts, strict=True)]
    placements = jax.block_until_ready(map_runs(place, scene, rows, tile))
    if filled:
        cut = lambda x: jnp.asarray(np.asarray(x)[:pop])
        placements = [jax.tree.map(cut, placement) for placement in placements]
    clock["score"] += time.perf_counter() - began
    return placements


def _plan(r: SearchResult, placement: Placement, scorer: SemanticScorer | None) -> RolloutPlan:
    c = r.run.options.cem
    pruned = prunes(r.run.options, r.problem) and scorer is None
    return RolloutPlan(
        placement,
        batch=c.batch if pruned else None,
        elites=elite_count(c.elite_ratio, len(placement.bound)),
        until_valid=c.credit == "auto" and not bool(r.state.seen_valid),
    )


class _Evaluation(NamedTuple):
    """Rolls populations out and scores them."""

    scene: SceneModel
    engine: Engine
    options: RefineOptions
    runs: int
    tile: int
    clock: dict[str, float]
    began: float

    def in_batches(
        self,
        live: Sequence[SearchResult],
        layouts: Sequence[Layout],
        placements: Sequence[Placement],
        plans: Sequence[RolloutPlan],
    ) -> None:
        """Follow the plans of all runs, one batch of each at a time."""
        while batches := {k: rows for k, p in enumerate(plans) if (rows := p.next()) is not None}:
            some = [take((layouts[k], placements[k]), rows) for k, rows in batches.items()]
            rollouts = self.roll_out([placement for _, placement in some])
            own = [live[k] for k in batches]
            for k, scores in zip(batches, self.score(own, some, rollouts), strict=True):
                plans[k].add(scores)

    def with_scorer(
        self,
        r: SearchResult,
        layouts: Layout,
        placement: Placement,
        plan: RolloutPlan,
        scorer: SemanticScorer,
    ) -> np.ndarray:
        """Roll out the population of one run while a model scores the best; return the marks."""
        t = len(r.rounds)
        scorer.submit(t, scorer.best(np.asarray(placement.bound)), layouts, placement.poses)
        rollouts = self.roll_out([placement])
        waiting = time.perf_counter()
        scorer.collect(t)
        self.clock["wait"] += time.perf_counter() - waiting
        values, marks = scorer.fill(t, layouts, np.asarray(placement.values["s_sem"].value))
        some = [(layouts, with_semantic(placement, values))]
        plan.add(self.score([r], some, rollouts)[0])
        return marks

    def roll_out(self, placements: Sequence[Placement]) -> list[Rollout]:
        """Roll the candidates of several runs out at once."""
        began = time.perf_counter()
        poses = [placement.poses for placement in placements]
        rollouts = roll_out(self.scene, poses, self.engine, self.options, self.runs)
        self.clock["rollout"] += time.perf_counter() - began
        return rollouts

    def score(
        self,
        live: Sequence[SearchResult],
        some: Sequence[tuple[Layout, Placement]],
        rollouts: Sequence[Rollout],
    ) -> list[Scores]:
        """Score the candidates of several runs, and note when the first valid one is known."""
        began = time.perf_counter()
        rows = [
            (*of, rollout, r.problem.objective)
            for r, of, rollout in zip(live, some, rollouts, strict=True)
        ]
        scored = jax.block_until_ready(map_runs(evaluate, self.scene, rows, self.tile))
        self.clock["score"] += time.perf_counter() - began
        for r, scores in zip(live, scored, strict=True):
            if np.isnan(r.first_valid_s) and bool(np.any(scores.valid)):
                r.first_valid_s = time.perf_counter() - self.began
        return scored


def with_semantic(placement: Placement, values: np.ndarray) -> Placement:
    """Put a model's scores in the place of the geometric ones."""
    s_sem = jnp.asarray(values, jnp.float32)
    term = lambda p: p.values["s_sem"]
    return eqx.tree_at(lambda p: (term(p).value, term(p).charged), placement, (s_sem, s_sem))


def _finalists(round_: Round, o: RefineOptions) -> Round:
    """Keep the candidates of an iteration that may be among the best `finalists` of all."""
    host: Round = jax.tree.map(np.asarray, round_)
    best = np.lexsort((-host.scores.absolute, ~host.scores.valid))[: o.finalists]
    # Sorted, as equal ones are taken in the order of the population.
    return jax.tree.map(lambda x: x[np.sort(best)], host)


def _line(r: SearchResult, scores: Scores) -> str:
    rolled = np.isfinite(np.asarray(scores.terms["d_drift"]))
    best = float(np.asarray(scores.absolute).max())
    share = float(np.asarray(scores.valid)[rolled].mean()) if rolled.any() else 0.0
    pruned = "" if rolled.all() else f", {1 - rolled.mean():.0%} pruned"
    return (
        f"iteration {len(r.rounds)}/{r.run.options.cem.iterations}: best {best:.3f}, "
        f"elites {float(r.state.elite_mean):.3f}, {share:.0%} valid{pruned}"
    )

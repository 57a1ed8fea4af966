"""Evaluation of populations: placed, rolled out and scored, those of several runs at once."""

import time
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..config import RefineOptions
from ..physics.engine import Engine, Rollout
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.placed import (
    Placed,
    at_rest_in_chunks,
    come_to_rest,
    placed,
    placed_in_chunks,
)
from ..physics.scene_arrays import SceneArrays
from .algorithm import Problem, initial_state, open_problem
from .batching import map_runs, pad_rollout, roll_out, settled, take
from .objective import Placement, Scores, evaluate, place
from .outcome import Round
from .pruning import RolloutPlan
from .rewards import Term
from .scorer import SemanticScorer
from .search_run import SearchResult, SearchRun, population_at, prunes
from .soundness import Soundness, soundness


class Evaluation(NamedTuple):
    """Rolls populations out and scores them."""

    scene: SceneModel
    arrays: SceneArrays
    engine: Engine
    options: RefineOptions
    runs: int
    tile: int
    clock: dict[str, float]
    began: float

    def place(
        self,
        problems: Sequence[Problem],
        layouts: Sequence[Layout],
        number: int,
        settles: Sequence[bool] = (),
    ) -> list[Placement]:
        """Place the populations of several runs, of which only the first `number` will be used.

        Args:
            problems: of the runs.
            layouts: their populations.
            number: candidates that will be used.
            settles: whether each run's candidates come to rest; none do by default.
        """
        began = time.perf_counter()
        if jax.default_backend() == "cpu":
            known = [placed_in_chunks(self.arrays, z, number) for z in layouts]
        else:
            known = map_runs(placed, self.arrays, [(z,) for z in layouts], self.tile)
        self.clock["score"] += time.perf_counter() - began
        settling = [k for k, flag in enumerate(settles) if flag]
        if settling:
            known = list(known)
            some = [known[k] for k in settling]
            for k, at in zip(settling, self._at_rest(some, number), strict=True):
                known[k] = at
        began = time.perf_counter()
        rows = [
            (z, problem.objective.bounded, at)
            for z, problem, at in zip(layouts, problems, known, strict=True)
        ]
        placements = map_runs(place, self.arrays, rows, self.tile)
        self.clock["score"] += time.perf_counter() - began
        return placements

    def _at_rest(self, known: Sequence[Placed], number: int) -> list[Placed]:
        """Let the first `number` candidates of several runs come to rest, and look again."""
        began = time.perf_counter()
        poses = [at.poses for at in known]
        ends = settled(self.scene, poses, self.engine, self.options, number)
        self.clock["rollout"] += time.perf_counter() - began
        began = time.perf_counter()
        pairs = list(zip(poses, ends, strict=True))
        if jax.default_backend() == "cpu":
            rest = [at_rest_in_chunks(self.arrays, start, end, number) for start, end in pairs]
        else:
            rest = map_runs(come_to_rest, self.arrays, pairs, self.tile)
        self.clock["score"] += time.perf_counter() - began
        return rest

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
        own = lambda tree: jax.tree.map(lambda x: x[:, : len(self.scene.names)], tree)
        layouts_, poses = own(layouts), own(placement.poses)
        scorer.submit(t, scorer.best(np.asarray(placement.bound)), layouts_, poses)
        rollouts = self.roll_out([placement])
        waiting = time.perf_counter()
        scorer.collect(t)
        self.clock["wait"] += time.perf_counter() - waiting
        values, marks = scorer.fill(t, layouts_, np.asarray(placement.values["s_sem"].value))
        some = [(layouts, with_semantic(placement, values))]
        plan.add(self.score([r], some, rollouts)[0])
        return marks

    def of_start(
        self, start: Layout, o: RefineOptions, terms: Sequence[Term]
    ) -> tuple[Round, Soundness]:
        """Evaluate the layout that a search starts at, and tell which objects are sound in it.

        It is repeated to the populations' length, so that nothing is compiled for it.
        """
        problem = open_problem(self.arrays, o, start, terms=terms)
        most = max(population_at(o, 0), population_at(o, 1))
        repeated = lambda tree, n: jax.tree.map(lambda x: np.repeat(np.asarray(x)[:1], n, 0), tree)
        (placement,) = self.place([problem], [repeated(start, most)], 1)
        first = take(placement, slice(1))
        (rollout,) = self.roll_out([first], runs=1)
        n = o.cem.batch if prunes(o, problem) else most
        many = eqx.tree_at(lambda r: r.time, repeated(rollout, n), rollout.time)
        r = SearchResult(SearchRun(o, 0), start, problem, initial_state(problem, start))
        (scores,) = self.score([r], [(repeated(start, n), repeated(first, n))], [many])
        scores = take(scores, slice(1))
        round_ = Round(take(repeated(start, 1), slice(1)), first.poses, scores, np.zeros(1, bool))
        return round_.of_objects(len(self.scene.names)), soundness(first, scores, o)

    def roll_out(self, placements: Sequence[Placement], runs: int | None = None) -> list[Rollout]:
        """Roll the candidates of several runs out at once."""
        began = time.perf_counter()
        poses = [placement.poses for placement in placements]
        rollouts = roll_out(self.scene, poses, self.engine, self.options, runs or self.runs)
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
            (*of, pad_rollout(rollout, self.arrays), r.problem.objective)
            for r, of, rollout in zip(live, some, rollouts, strict=True)
        ]
        scored = map_runs(evaluate, self.arrays, rows, self.tile)
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

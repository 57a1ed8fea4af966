"""Evaluation of populations: placed, rolled out and scored, those of several runs at once."""

import time
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..config import RefineOptions
from ..measure import SceneMeasure, measured
from ..physics.engine import Engine, Rollout
from ..physics.exact import snap_exactly
from ..physics.layout import Layout, Poses
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
from .batching import map_runs, pad_rollout, put, roll_out, settled, take
from .objective import Placement, Scores, evaluate, place
from .outcome import Round
from .pruning import RolloutPlan
from .rewards import Term
from .scorer import SemanticScorer
from .search_run import SearchResult, SearchRun, population_at, prunes
from .soundness import Soundness, failing, soundness


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
        settles: Sequence[int] = (),
    ) -> list[Placement]:
        """Place the populations of several runs, of which only the first `number` will be used.

        Args:
            problems: of the runs.
            layouts: their populations.
            number: candidates that will be used.
            settles: how many of each run's candidates come to rest, those that agree best with the
                photograph; where some do, the others are left out. None do by default.
        """
        began = time.perf_counter()
        if jax.default_backend() == "cpu":
            known = [placed_in_chunks(self.arrays, z, number) for z in layouts]
        else:
            known = map_runs(placed, self.arrays, [(z,) for z in layouts], self.tile)
        settling = [k for k, most in enumerate(settles) if most]
        screened = {}
        if settling:
            known = [jax.tree.map(np.asarray, at) for at in known]
            # Come to rest, things overlap no more.
            apart = [(problems[k], layouts[k], _apart(known[k])) for k in settling]
            for k, placement in zip(settling, self._placements(apart), strict=True):
                order = np.argsort(-np.asarray(placement.bound)[:number], kind="stable")
                screened[k] = np.sort(order[: settles[k]])
            self.clock["score"] += time.perf_counter() - began
            some = [(known[k], rows) for k, rows in screened.items()]
            for k, at in zip(screened, self._at_rest(some), strict=True):
                known[k] = at
            began = time.perf_counter()
        placements = self._placements(list(zip(problems, layouts, known, strict=True)))
        for k, rows in screened.items():
            placements[k] = _left_out(placements[k], rows)
        self.clock["score"] += time.perf_counter() - began
        return placements

    def _placements(self, of: Sequence[tuple[Problem, Layout, Placed]]) -> list[Placement]:
        rows = [(z, problem.objective.bounded, at) for problem, z, at in of]
        return map_runs(place, self.arrays, rows, self.tile)

    def _at_rest(self, some: Sequence[tuple[Placed, np.ndarray]]) -> list[Placed]:
        """Let some candidates of several runs come to rest, and look at them again."""
        began = time.perf_counter()
        starts = [take(at.poses, rows) for at, rows in some]
        ends = settled(self.scene, starts, self.engine, self.options)
        self.clock["rollout"] += time.perf_counter() - began
        began = time.perf_counter()
        pairs = list(zip(starts, ends, strict=True))
        if jax.default_backend() == "cpu":
            rest = [at_rest_in_chunks(self.arrays, start, end) for start, end in pairs]
        else:
            rest = self._seen_at_rest(pairs)
        whole = [
            jax.tree.map(lambda x, new, rows=rows: put(x, new, rows), at, new)
            for (at, rows), new in zip(some, rest, strict=True)
        ]
        self.clock["score"] += time.perf_counter() - began
        return whole

    def _seen_at_rest(self, pairs: Sequence[tuple[Poses, Poses]]) -> list[Placed]:
        """Look at runs with equal numbers of candidates at once."""
        rest: dict[int, Placed] = {}
        sizes = [len(start.scale) for start, _ in pairs]
        for size in sorted(set(sizes)):
            which = [k for k, own in enumerate(sizes) if own == size]
            mapped = map_runs(come_to_rest, self.arrays, [pairs[k] for k in which], self.tile)
            rest |= dict(zip(which, mapped, strict=True))
        return [rest[k] for k in range(len(pairs))]

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
    ) -> tuple[Round, Soundness, SceneMeasure]:
        """Evaluate the layout that a search starts at, and tell which objects are sound in it.

        It is repeated to the populations' length, so that nothing is compiled for it.

        Returns:
            The layout as an iteration, its soundness, and its final check.
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
        measure = measured(snap_exactly(self.scene.apply(start, 0)), o)
        sound = soundness(first, scores, failing(self.scene.names, measure, o), o)
        return round_.of_objects(len(self.scene.names)), sound, measure

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


def _left_out(placement: Placement, kept: np.ndarray) -> Placement:
    """Leave all candidates but some out: they have no bound, and no engine simulates them."""
    keep = lambda x, none: put(np.full_like(x, none), np.asarray(x)[kept], kept)
    poses = jax.tree.map(lambda x: keep(x, np.nan), placement.poses)
    return eqx.tree_at(
        lambda p: (p.poses, p.bound), placement, (poses, keep(placement.bound, -np.inf))
    )


def _apart(at: Placed) -> Placed:
    """Return placed candidates as if nothing overlapped."""
    return eqx.tree_at(lambda p: p.depth, at, np.zeros_like(at.depth))


def with_semantic(placement: Placement, values: np.ndarray) -> Placement:
    """Put a model's scores in the place of the geometric ones."""
    s_sem = jnp.asarray(values, jnp.float32)
    term = lambda p: p.values["s_sem"]
    return eqx.tree_at(lambda p: (term(p).value, term(p).charged), placement, (s_sem, s_sem))

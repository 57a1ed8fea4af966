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
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.placed import (
    Placed,
    approximated,
    approximated_in_chunks,
    at_rest_in_chunks,
    placed,
    placed_at_rest,
    placed_in_chunks,
    placed_poses,
    poses_in_chunks,
)
from ..physics.scene_arrays import SceneArrays
from ..traces import computes_on_cpu
from .algorithm import Problem, initial_state, open_problem, project, projects
from .batching import map_runs, pad_rollout, put, roll_out, settled, take
from .feasibility import InitialFeasibility, assess_initial, failing
from .objective import Placement, Scores, evaluate, place
from .pruning import RolloutPlan
from .rewards import Term
from .rounds import Round
from .scorer import SemanticScorer
from .search_run import SearchResult, SearchRun, population_at, prunes


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
        rests: Sequence[bool] = (),
    ) -> list[Placement]:
        """Place the populations of several runs, of which only the first `number` will be used.

        Args:
            problems: of the runs.
            layouts: their populations.
            number: candidates that will be used.
            rests: whether each run's candidates will come to rest; they are bounded as if nothing
                overlapped, for when they have, nothing does, and nothing hid anything: they are
                looked at where they rest. None will by default.
        """
        began = time.perf_counter()
        resting = rests or [False] * len(layouts)
        known: dict[int, Placed] = {}
        for rest in set(resting):
            own = [k for k in range(len(layouts)) if resting[k] == rest]
            if computes_on_cpu():
                look = approximated_in_chunks if rest else placed_in_chunks
                new = [look(self.arrays, layouts[k], number) for k in own]
            else:
                rows = [(layouts[k],) for k in own]
                new = map_runs(_approximated if rest else placed, self.arrays, rows, self.tile)
            known |= zip(own, new, strict=True)
        placements = self._placements(
            [(problems[k], layouts[k], known[k]) for k in range(len(layouts))]
        )
        self.clock["score"] += time.perf_counter() - began
        return placements

    def _placements(self, of: Sequence[tuple[Problem, Layout, Placed]]) -> list[Placement]:
        rows = [(z, problem.objective.bounded, at) for problem, z, at in of]
        return map_runs(place, self.arrays, rows, self.tile)

    def run_plans(
        self,
        live: Sequence[SearchResult],
        layouts: list[Layout],
        placements: list[Placement],
        plans: Sequence[RolloutPlan],
    ) -> None:
        """Follow the plans of all runs, one batch of each at a time.

        Layouts and placements of what comes to rest are replaced.
        """
        while True:
            batches = {k: rows for k, p in enumerate(plans) if (rows := p.next()) is not None}
            idle = [k for k in range(len(plans)) if k not in batches]
            waiting = {k: rows for k in idle if (rows := plans[k].waiting()) is not None}
            if waiting:
                self._settle_waiting(live, layouts, placements, plans, waiting)
                continue
            if not batches:
                return
            some = [take((layouts[k], placements[k]), rows) for k, rows in batches.items()]
            rollouts = self.roll_out([placement for _, placement in some])
            own = [live[k] for k in batches]
            for k, scores in zip(batches, self.score(own, some, rollouts), strict=True):
                plans[k].add(scores)

    def _settle_waiting(
        self,
        live: Sequence[SearchResult],
        layouts: list[Layout],
        placements: list[Placement],
        plans: Sequence[RolloutPlan],
        waiting: dict[int, np.ndarray],
    ) -> None:
        """Project candidates where the options say so, let them come to rest, and look again."""
        began = time.perf_counter()
        d, on_cpu = self.options.descent, computes_on_cpu()
        projection = (d.project_steps, d.rate, d.samples)
        # All runs take so many at once; the last are filled up, so that one shape is compiled.
        few = {k: take(layouts[k], np.resize(rows, plans[k].rests)) for k, rows in waiting.items()}
        moved = [k for k in few if projects(d.project, len(live[k].rounds), live[k].state)]
        if moved:
            rows = [(live[k].problem, few[k], projection) for k in moved]
            few |= zip(moved, map_runs(project, self.arrays, rows, self.tile), strict=True)
        self.clock["descent"] += time.perf_counter() - began
        if on_cpu:
            starts = [poses_in_chunks(self.arrays, z) for z in few.values()]
        else:
            starts = map_runs(placed_poses, self.arrays, [(z,) for z in few.values()], self.tile)
        began = time.perf_counter()
        own = [
            take(at, slice(len(rows))) for at, rows in zip(starts, waiting.values(), strict=True)
        ]
        ends = settled(self.scene, own, self.engine, self.options, self.runs)
        self.clock["rollout"] += time.perf_counter() - began
        began = time.perf_counter()
        pairs = [
            (start, take(end, np.resize(np.arange(len(end.scale)), len(start.scale))))
            for start, end in zip(starts, ends, strict=True)
        ]
        if on_cpu:
            looked = [at_rest_in_chunks(self.arrays, *pair) for pair in pairs]
        else:
            looked = map_runs(placed_at_rest, self.arrays, pairs, self.tile)
        placed_now = []
        for (k, rows), at in zip(waiting.items(), looked, strict=True):
            put_in = lambda x, new, rows=rows: put(x, new[: len(rows)], rows)
            layouts[k] = jax.tree.map(put_in, layouts[k], few[k])
            p = placements[k]
            whole = Placed(p.poses, p.depth, p.visible, p.settled)
            placed_now.append((live[k].problem, layouts[k], jax.tree.map(put_in, whole, at)))
        for k, placement in zip(waiting, self._placements(placed_now), strict=True):
            plans[k].placed_at_rest(placement)
            placements[k] = _without_others(placement, plans[k].ready)
        self.clock["score"] += time.perf_counter() - began

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

    def evaluate_initial(
        self, start: Layout, o: RefineOptions, terms: Sequence[Term]
    ) -> tuple[Round, InitialFeasibility, SceneMeasure]:
        """Evaluate the layout that a search starts at, and tell which objects are sound in it.

        It is repeated to the populations' length, so that nothing is compiled for it.

        Returns:
            The layout as an iteration, its feasibility, and its final check.
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
        sound = assess_initial(first, scores, failing(self.scene.names, measure, o), o)
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


def _without_others(placement: Placement, kept: np.ndarray) -> Placement:
    """Leave all candidates but some out: they have no bound, and no engine simulates them."""
    keep = lambda x, none: put(np.full_like(x, none), np.asarray(x)[kept], kept)
    poses = jax.tree.map(lambda x: keep(x, np.nan), placement.poses)
    return eqx.tree_at(
        lambda p: (p.poses, p.bound), placement, (poses, keep(placement.bound, -np.inf))
    )


def _approximated(scene: SceneArrays, layouts: Layout) -> Placed:
    return approximated(scene, placed_poses(scene, layouts))


def with_semantic(placement: Placement, values: np.ndarray) -> Placement:
    """Put a model's scores in the place of the geometric ones."""
    s_sem = jnp.asarray(values, jnp.float32)
    term = lambda p: p.values["s_sem"]
    return eqx.tree_at(lambda p: (term(p).value, term(p).charged), placement, (s_sem, s_sem))

"""Evaluation of the populations of several runs: placement, settling, rollouts and scores."""

import time
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..config import RefineOptions
from ..measure import SceneMeasure, measured
from ..physics.array_types import AnyArray
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
from .batching import map_runs, pad_rollout, put, roll_out, settle_candidates, take
from .feasibility import InitialFeasibility, assess_initial, failing
from .objective import Placement, Scores, evaluate, place
from .pruning import RolloutPlan
from .rewards import Term, TermValue
from .rounds import Round
from .scorer import SemanticScorer
from .search_run import SearchResult, SearchRun, population_at, prunes


class Evaluation(NamedTuple):
    """Placement, rollouts and scores of populations, with the time spent on each."""

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
        """Place the populations of several runs, of which only the first `number` are used.

        Args:
            problems: the runs' problems.
            layouts: the runs' populations.
            number: number of candidates that are used.
            rests: per run, True if its candidates are settled before they are scored. Their bounds
                then ignore overlap and occlusion, which are measured after settling. Default:
                False for all.
        """
        began = time.perf_counter()
        settled_flags = rests or [False] * len(layouts)
        known: dict[int, Placed] = {}
        for is_settled in set(settled_flags):
            members = [k for k in range(len(layouts)) if settled_flags[k] == is_settled]
            if computes_on_cpu():
                place_chunks = approximated_in_chunks if is_settled else placed_in_chunks
                newly_placed = [place_chunks(self.arrays, layouts[k], number) for k in members]
            else:
                rows = [(layouts[k],) for k in members]
                newly_placed = map_runs(
                    _approximated if is_settled else placed, self.arrays, rows, self.tile
                )
            known |= zip(members, newly_placed, strict=True)
        placements = self._placements(
            [(problems[k], layouts[k], known[k]) for k in range(len(layouts))]
        )
        self.clock["score"] += time.perf_counter() - began
        return placements

    def _placements(
        self, placed_layouts: Sequence[tuple[Problem, Layout, Placed]]
    ) -> list[Placement]:
        rows = [(z, problem.objective.bounded, known) for problem, z, known in placed_layouts]
        return map_runs(place, self.arrays, rows, self.tile)

    def run_plans(
        self,
        live: Sequence[SearchResult],
        layouts: list[Layout],
        placements: list[Placement],
        plans: Sequence[RolloutPlan],
    ) -> None:
        """Execute the plans of all runs, one batch of each at a time.

        Layouts and placements of settled candidates are replaced.
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
            candidates = [take((layouts[k], placements[k]), rows) for k, rows in batches.items()]
            rollouts = self.roll_out([placement for _, placement in candidates])
            batch_runs = [live[k] for k in batches]
            for k, scores in zip(
                batches, self.score(batch_runs, candidates, rollouts), strict=True
            ):
                plans[k].add(scores)

    def _settle_waiting(
        self,
        live: Sequence[SearchResult],
        layouts: list[Layout],
        placements: list[Placement],
        plans: Sequence[RolloutPlan],
        waiting: dict[int, np.ndarray],
    ) -> None:
        """Project waiting candidates if the options request it, settle them, and re-place them."""
        began = time.perf_counter()
        d, on_cpu = self.options.descent, computes_on_cpu()
        projection = (d.project_steps, d.rate, d.samples)
        # Batches are padded to the same length, so that one shape is compiled.
        batch_layouts = {
            k: take(layouts[k], np.resize(rows, plans[k].rests)) for k, rows in waiting.items()
        }
        moved = [
            k for k in batch_layouts if projects(d.project, len(live[k].rounds), live[k].state)
        ]
        if moved:
            rows = [(live[k].problem, batch_layouts[k], projection) for k in moved]
            batch_layouts |= zip(
                moved, map_runs(project, self.arrays, rows, self.tile), strict=True
            )
        self.clock["descent"] += time.perf_counter() - began
        if on_cpu:
            initial_poses = [poses_in_chunks(self.arrays, z) for z in batch_layouts.values()]
        else:
            initial_poses = map_runs(
                placed_poses, self.arrays, [(z,) for z in batch_layouts.values()], self.tile
            )
        began = time.perf_counter()
        unsettled = [
            take(placed_batch, slice(len(rows)))
            for placed_batch, rows in zip(initial_poses, waiting.values(), strict=True)
        ]
        settled_poses = settle_candidates(
            self.scene, unsettled, self.engine, self.options, self.runs
        )
        self.clock["rollout"] += time.perf_counter() - began
        began = time.perf_counter()
        pairs = [
            (
                initial,
                take(settled_end, np.resize(np.arange(len(settled_end.scale)), len(initial.scale))),
            )
            for initial, settled_end in zip(initial_poses, settled_poses, strict=True)
        ]
        if on_cpu:
            settled_placements = [at_rest_in_chunks(self.arrays, *pair) for pair in pairs]
        else:
            settled_placements = map_runs(placed_at_rest, self.arrays, pairs, self.tile)
        updated = []
        for (k, rows), placed_batch in zip(waiting.items(), settled_placements, strict=True):
            put_rows = partial(_put_rows, rows)
            layouts[k] = jax.tree.map(put_rows, layouts[k], batch_layouts[k])
            p = placements[k]
            whole = Placed(p.poses, p.depth, p.visible, p.settled)
            updated.append(
                (live[k].problem, layouts[k], jax.tree.map(put_rows, whole, placed_batch))
            )
        for k, placement in zip(waiting, self._placements(updated), strict=True):
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
        """Roll out the population of one run while a model scores its best; return the marks."""
        t = len(r.rounds)

        def unpad(tree: Any) -> Any:
            return jax.tree.map(lambda x: x[:, : len(self.scene.names)], tree)

        layouts_, poses = unpad(layouts), unpad(placement.poses)
        scorer.submit(t, scorer.best(np.asarray(placement.bound)), layouts_, poses)
        rollouts = self.roll_out([placement])
        waiting = time.perf_counter()
        scorer.collect(t)
        self.clock["wait"] += time.perf_counter() - waiting
        values, marks = scorer.fill(t, layouts_, np.asarray(placement.values["s_sem"].value))
        candidates = [(layouts, with_semantic(placement, values))]
        plan.add(self.score([r], candidates, rollouts)[0])
        return marks

    def evaluate_initial(
        self, start: Layout, o: RefineOptions, terms: Sequence[Term]
    ) -> tuple[Round, InitialFeasibility, SceneMeasure]:
        """Evaluate the initial layout of a search, and the feasibility of each object in it.

        The layout is repeated to the population size, to reuse compiled programs.

        Returns:
            The layout as an iteration, its feasibility, and its final check.
        """
        problem = open_problem(self.arrays, o, start, terms=terms)
        population = max(population_at(o, 0), population_at(o, 1))

        def repeated(tree: Any, n: int) -> Any:
            return jax.tree.map(lambda x: np.repeat(np.asarray(x)[:1], n, 0), tree)

        (placement,) = self.place([problem], [repeated(start, population)], 1)
        first = take(placement, slice(1))
        (rollout,) = self.roll_out([first], runs=1)
        n = o.cem.batch if prunes(o, problem) else population
        rollouts = eqx.tree_at(lambda r: r.time, repeated(rollout, n), rollout.time)
        r = SearchResult(SearchRun(o, 0), start, problem, initial_state(problem, start))
        (scores,) = self.score([r], [(repeated(start, n), repeated(first, n))], [rollouts])
        scores = take(scores, slice(1))
        round_ = Round(take(repeated(start, 1), slice(1)), first.poses, scores, np.zeros(1, bool))
        measure = measured(snap_exactly(self.scene.apply(start, 0)), o)
        feasibility = assess_initial(first, scores, failing(self.scene.names, measure, o), o)
        return round_.of_objects(len(self.scene.names)), feasibility, measure

    def roll_out(self, placements: Sequence[Placement], runs: int | None = None) -> list[Rollout]:
        """Roll out the candidates of several runs at once."""
        began = time.perf_counter()
        poses = [placement.poses for placement in placements]
        rollouts = roll_out(self.scene, poses, self.engine, self.options, runs or self.runs)
        self.clock["rollout"] += time.perf_counter() - began
        return rollouts

    def score(
        self,
        live: Sequence[SearchResult],
        batches: Sequence[tuple[Layout, Placement]],
        rollouts: Sequence[Rollout],
    ) -> list[Scores]:
        """Score the candidates of several runs, and record the time of the first valid one."""
        began = time.perf_counter()
        rows = [
            (*candidates, pad_rollout(rollout, self.arrays), r.problem.objective)
            for r, candidates, rollout in zip(live, batches, rollouts, strict=True)
        ]
        scored = map_runs(evaluate, self.arrays, rows, self.tile)
        self.clock["score"] += time.perf_counter() - began
        for r, scores in zip(live, scored, strict=True):
            if np.isnan(r.first_valid_s) and bool(np.any(scores.valid)):
                r.first_valid_s = time.perf_counter() - self.began
        return scored


def _put_rows(rows: np.ndarray, whole: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Replace rows of an array by the first rows of another one."""
    return put(whole, new[: len(rows)], rows)


def _without_others(placement: Placement, rows: np.ndarray) -> Placement:
    """Exclude all candidates except `rows`: set bounds to -inf and poses to NaN."""

    def keep(x: AnyArray, fill: float) -> np.ndarray:
        return put(np.full_like(x, fill), np.asarray(x)[rows], rows)

    poses = jax.tree.map(lambda x: keep(x, np.nan), placement.poses)
    return eqx.tree_at(
        lambda p: (p.poses, p.bound), placement, (poses, keep(placement.bound, -np.inf))
    )


def _approximated(scene: SceneArrays, layouts: Layout) -> Placed:
    return approximated(scene, placed_poses(scene, layouts))


def with_semantic(placement: Placement, values: np.ndarray) -> Placement:
    """Replace the geometric semantic scores by a model's scores."""
    s_sem = jnp.asarray(values, jnp.float32)

    def term(p: Placement) -> TermValue:
        return p.values["s_sem"]

    return eqx.tree_at(lambda p: (term(p).value, term(p).charged), placement, (s_sem, s_sem))

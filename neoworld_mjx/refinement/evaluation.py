"""Placement, settling, rollouts and scoring of the populations of several runs."""

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from ..cache import computes_on_cpu
from ..config import RefineOptions
from ..physics.engine import Engine, Rollout, zero_duration_rollout
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from ..physics.placed import (
    Placed,
    measure_in_chunks,
    measure_settled,
    place_in_chunks,
)
from ..physics.scene_arrays import SceneArrays, pad_objects
from ..spec import SceneSpec
from .batching import concatenate_candidates, map_runs, pad_rollout, roll_out, settle_candidates
from .finishing import resting_poses
from .objective import Scores, evaluate
from .rounds import Round
from .search_run import SearchResult


class Evaluation(NamedTuple):
    """Places, settles, rolls out and scores populations, and measures the time of each step."""

    scene: SceneModel
    arrays: SceneArrays
    """Scene that terms and optimizers receive: the padded scene if all of them accept it."""
    padded: SceneArrays
    """Padded scene, in which candidates are measured. Scenes of a bucket share compiled
    functions."""
    engine: Engine
    options: RefineOptions
    runs: int
    """Number of runs at the start of the search."""
    tile: int
    """Number of runs that are batched."""
    clock: dict[str, float]
    """Seconds spent on each step; updated in place."""
    began: float
    """Start of the search, by `time.perf_counter`."""

    def place(self, layouts: Sequence[Layout]) -> list[Placed]:
        """Place the populations of several runs, settle them if enabled, and measure the result."""
        began = time.perf_counter()
        on_cpu, pop = computes_on_cpu(), self.options.cem.population
        if on_cpu:
            starts = [place_in_chunks(self.arrays, z) for z in layouts]
        else:
            rows = [(z,) for z in layouts]
            starts = map_runs(SceneArrays.place, self.arrays, rows, self.tile, pop)
        ends, placing = starts, time.perf_counter() - began
        if self.options.settle.enabled:
            ends = settle_candidates(self.scene, starts, self.engine, self.options, self.runs)
        settling = time.perf_counter() - began - placing
        placed = self.measure(list(zip(starts, ends, strict=True)))
        self.clock["settle"] += settling
        self.clock["score"] += time.perf_counter() - began - settling
        return placed

    def measure(self, pairs: Sequence[tuple[Poses, Poses]]) -> list[Placed]:
        """Measure populations, given the placed poses and the settled poses of each."""
        pairs = [pad_objects(pair, self.padded.count) for pair in pairs]
        if computes_on_cpu():
            placed = [measure_in_chunks(self.padded, *pair) for pair in pairs]
        else:
            population = self.options.cem.population
            placed = map_runs(measure_settled, self.padded, pairs, self.tile, population)
        count = self.arrays.count
        if count == self.padded.count:
            return placed
        placed = [jax.tree.map(lambda x: np.asarray(x)[:, :count], p) for p in placed]
        return [eqx.tree_at(lambda p: p.depth, p, p.depth[:, :, :count]) for p in placed]

    def roll_out(self, placed: Sequence[Placed]) -> list[Rollout]:
        """Roll out the candidates of several runs at once."""
        began = time.perf_counter()
        poses = [candidates.poses for candidates in placed]
        rollouts = roll_out(self.scene, poses, self.engine, self.options, self.runs)
        self.clock["rollout"] += time.perf_counter() - began
        return rollouts

    def score(
        self,
        active: Sequence[SearchResult],
        layouts: Sequence[Layout],
        placed: Sequence[Placed],
        rollouts: Sequence[Rollout],
        s_sem: np.ndarray | None = None,
    ) -> list[Scores]:
        """Score the candidates of several runs.

        Args:
            active: the runs.
            layouts: population of each run.
            placed: placed candidates of each run.
            rollouts: rollout of each run's candidates.
            s_sem: S_sem by a model, which replaces the geometric S_sem.
        """
        began = time.perf_counter()
        rows: list[tuple[Any, ...]] = [
            (z, candidates, pad_rollout(rollout, self.arrays), r.problem.objective, s_sem)
            for r, z, candidates, rollout in zip(active, layouts, placed, rollouts, strict=True)
        ]
        scored = map_runs(evaluate, self.arrays, rows, self.tile, self.options.cem.population)
        self.clock["score"] += time.perf_counter() - began
        return scored

    def score_initials(self, results: Sequence[SearchResult]) -> list[Round]:
        """Score the initial layout of each run at its settled poses.

        Returns:
            One iteration for each run, with the initial layout as the only candidate.
        """
        layouts = [r.problem.origin for r in results]
        rests = [
            self.settled_poses(r.initial.scene, z) for r, z in zip(results, layouts, strict=True)
        ]
        scores = self.score_each(results, layouts, rests, rests)
        return [self.unpadded_round(*row) for row in zip(layouts, rests, scores, strict=True)]

    def settled_poses(self, scene: SceneSpec, layout: Layout) -> Poses:
        """Return the padded poses of a settled scene, with the scales of the padded layout."""
        scale = np.exp(np.asarray(layout.log_scale)[:, : len(self.scene.names)])
        rest = pad_objects(resting_poses(scene, scale), self.arrays.count)
        return jax.tree.map(np.float32, rest)

    def score_each(
        self,
        results: Sequence[SearchResult],
        layouts: Sequence[Layout],
        starts: Sequence[Poses],
        rests: Sequence[Poses],
        s_sem: np.ndarray | None = None,
    ) -> list[Scores]:
        """Roll out and score one candidate of each run from its settled poses.

        The candidate is repeated to the population size, so that functions which were compiled for
        the search are reused.

        Args:
            results: the runs.
            layouts: padded layout of each run's candidate, with a population axis of length 1.
            starts: placed poses of each candidate.
            rests: settled poses of each candidate.
            s_sem: S_sem by a model, which replaces the geometric S_sem in all runs; shape [1].
        """
        population = self.options.cem.population

        def repeat(tree: Any) -> Any:
            rows = np.zeros(population, int)
            return jax.tree.map(lambda x: np.asarray(x)[rows], tree)

        rolled = roll_out(self.scene, rests, self.engine, self.options, len(results))
        rollouts = [eqx.tree_at(lambda x: x.time, repeat(r), r.time) for r in rolled]
        if computes_on_cpu():
            (measures,) = self.measure(
                [(concatenate_candidates(starts), concatenate_candidates(rests))]
            )
            placed = [
                repeat(jax.tree.map(lambda x, k=k: np.asarray(x)[k : k + 1], measures))
                for k in range(len(results))
            ]
        else:
            pairs = [(repeat(a), repeat(b)) for a, b in zip(starts, rests, strict=True)]
            placed = self.measure(pairs)
        s_sem = None if s_sem is None else repeat(s_sem)
        scores = self.score(results, [repeat(z) for z in layouts], placed, rollouts, s_sem)
        return [jax.tree.map(lambda x: np.asarray(x)[:1], of_run) for of_run in scores]

    def before_physics(self, r: SearchResult, layouts: Layout, placed: Placed) -> Scores:
        """Score candidates as if no object moved, with the geometric S_sem."""
        motionless = zero_duration_rollout(self.arrays, placed.poses)
        return jax.device_get(
            evaluate(self.arrays, layouts, placed, motionless, r.problem.objective)
        )

    def unpadded_round(self, layouts: Layout, poses: Poses, scores: Scores) -> Round:
        """Return an iteration from which padded objects are removed."""
        count = len(self.scene.names)
        per_object = lambda s: (s.drift, s.depth, s.rested)
        unpadded_fields = tuple(np.asarray(x)[:, :count] for x in per_object(scores))
        scores = eqx.tree_at(per_object, scores, unpadded_fields)
        return Round(self.unpadded(layouts), self.unpadded(poses), scores)

    def unpadded(self, tree: Any) -> Any:
        """Remove padded objects from the arrays [pop, object, ...] of a pytree."""
        return jax.tree.map(lambda x: np.asarray(x)[:, : len(self.scene.names)], tree)

"""Placement, settling, rollouts and scoring of a population, on the host and its devices."""

import contextlib
import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Int8

from ..config import RefineOptions
from ..physics.array_types import AnyArray
from ..physics.engine import EarlyStop, Engine, Rollout, zero_duration_rollout
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from ..physics.placed import Placed, measure_in_chunks, place_in_chunks
from ..physics.rest import settle
from ..physics.scene_arrays import SceneArrays, on_device, pad_axis, pad_objects, pad_scene
from .algorithm import Problem, Scores, evaluate, open_problem
from .optimizer import Optimizer
from .rewards import Term

CLOCKS = ("settle", "rollout", "score", "wait")
"""Steps of a search whose time is measured."""
PADDED_OPTIMIZERS = ("cem", "random")
"""Optimizers that accept a padded scene."""


@contextlib.contextmanager
def timed(clock: dict[str, float], step: str) -> Iterator[None]:
    """Add the time of a block [s] to a step."""
    began = time.perf_counter()
    yield
    clock[step] = clock.get(step, 0.0) + time.perf_counter() - began


class Round(NamedTuple):
    """One iteration, without padded objects."""

    layouts: Layout
    poses: Poses
    """Poses of the candidates: settled poses if settling is enabled, else placed poses."""
    scores: Scores
    s_sem_from: Int8[np.ndarray, " pop"] | None = None
    """Source of each S_sem (`scorer.ScoreSource`); None if it is geometric for all."""


class Evaluation(NamedTuple):
    """Places, settles, rolls out and scores populations, and measures the time of each step."""

    scene: SceneModel
    arrays: SceneArrays
    """Scene that terms and optimizers receive: the padded scene if all of them are built in."""
    padded: SceneArrays
    """Padded scene, in which candidates are measured. Scenes of a bucket share compiled
    functions."""
    engine: Engine
    options: RefineOptions
    problem: Problem
    clock: dict[str, float]
    """Seconds spent on each step; updated in place."""

    def place(self, layouts: Layout) -> Placed:
        """Place a population, settle it if enabled, and measure the result."""
        with timed(self.clock, "score"):
            start = place_in_chunks(self.arrays, layouts)
        end = start
        if self.options.settle.enabled:
            with timed(self.clock, "settle"):
                ends = settle(self.scene, self.unpadded(start), self.engine, self.options.settle)
                end = jax.tree.map(_with_first_objects, start, ends)
        with timed(self.clock, "score"):
            return self.measure(start, end)

    def measure(self, start: Poses, end: Poses) -> Placed:
        """Measure a population, given the placed poses and the settled poses."""
        start, end = pad_objects((start, end), self.padded.count)
        placed, count = measure_in_chunks(self.padded, start, end), self.arrays.count
        placed = jax.tree.map(lambda x: np.asarray(x)[:, :count], placed)
        return eqx.tree_at(lambda p: p.depth, placed, placed.depth[:, :, :count])

    def roll_out(self, poses: Poses) -> Rollout:
        """Roll out candidates from their poses; the result is on the host and not padded."""
        r, poses = self.options.rollout, self.unpadded(poses)
        with timed(self.clock, "rollout"):
            if not r.duration_s:
                return jax.device_get(zero_duration_rollout(self.scene, poses))
            rollout = self.engine.rollout(
                self.scene,
                poses,
                duration=r.duration_s,
                record_every=r.record_every_s,
                early_stop=early_stop_rule(self.options) if r.early_stop else None,
            )
            return jax.device_get(rollout)

    def score(
        self, layouts: Layout, placed: Placed, rollout: Rollout, s_sem: np.ndarray | None = None
    ) -> Scores:
        """Score a population; `s_sem` by a model replaces the geometric S_sem."""
        with timed(self.clock, "score"):
            padded = pad_rollout(rollout, self.arrays)
            scores = evaluate(self.arrays, self.problem, layouts, padded, placed, s_sem)
            return jax.device_get(scores)

    def score_before_physics(self, layouts: Layout, placed: Placed) -> Scores:
        """Score candidates as if no object moved, with the geometric S_sem."""
        motionless = zero_duration_rollout(self.arrays, placed.poses)
        return jax.device_get(evaluate(self.arrays, self.problem, layouts, motionless, placed))

    def round(
        self, layouts: Layout, poses: Poses, scores: Scores, sources: np.ndarray | None = None
    ) -> Round:
        """Return an iteration from which padded objects are removed."""
        scores = eqx.tree_at(lambda s: s.rests, scores, self.unpadded(scores.rests))
        return Round(self.unpadded(layouts), self.unpadded(poses), scores, sources)

    def unpadded(self, tree: Any) -> Any:
        """Remove padded objects from the arrays [pop, object, ...] of a pytree, on the host."""
        return jax.tree.map(lambda x: np.asarray(x)[:, : len(self.scene.names)], tree)


def open_evaluation(
    scene: SceneModel,
    o: RefineOptions,
    engine: Engine,
    *,
    resting: Bool[np.ndarray, " object"] | None = None,
    terms: Sequence[Term] = (),
    optimizer: Optimizer | None = None,
    clock: dict[str, float] | None = None,
) -> Evaluation:
    """Return the evaluation of a search that starts at the composed scene.

    Args:
        scene: the compiled scene.
        o: options of the search.
        engine: physics engine.
        resting: mask of the objects that are not sampled; they move only with their supports.
        terms: reward terms in addition to those that the options name.
        optimizer: replaces the optimizer that the options name.
        clock: seconds spent on each step; updated in place.

    Raises:
        ConfigError: as `open_problem`.
    """
    padded = pad_scene(scene)
    own = bool(terms or o.reward.terms or optimizer)
    arrays = padded if not own and o.optimizer in PADDED_OPTIMIZERS else scene
    moves = np.array(arrays.optimised)
    if resting is not None:
        moves &= ~pad_axis(resting, arrays.count)
    moving = eqx.tree_at(lambda s: s.optimised, arrays, on_device(moves))
    problem = open_problem(moving, o, terms=terms, optimizer=optimizer)
    clock = {} if clock is None else clock
    clock |= dict.fromkeys(CLOCKS, 0.0) | clock
    return Evaluation(scene, arrays, padded, engine, o, problem, clock)


def _with_first_objects(whole: np.ndarray, part: AnyArray) -> np.ndarray:
    """Return a copy of an array [pop, object, ...] whose first objects are those of `part`."""
    copied = np.array(whole)
    copied[:, : np.shape(part)[1]] = part
    return copied


def pad_rollout(rollout: Rollout, scene: SceneArrays) -> Rollout:
    """Pad a rollout on the host to the size of a padded scene; padded objects do not move."""

    def pad(x: AnyArray, length: int) -> np.ndarray:
        return np.moveaxis(pad_axis(np.moveaxis(np.asarray(x), 2, 0), length), 0, 2)

    return Rollout(
        time=rollout.time,
        pos=pad(rollout.pos, scene.count),
        quat=pad(rollout.quat, scene.count),
        joint_shift=pad(rollout.joint_shift, len(scene.joint_object)),
        status=rollout.status,
        start=pad_objects(rollout.start, scene.count),
        steps=rollout.steps,
    )


def early_stop_rule(o: RefineOptions) -> EarlyStop:
    """Return the rule by which rollouts stop early, from the bounds and the scale of D_drift.

    Drift beyond the scale does not change the validity of a candidate, and hardly its reward.
    """
    distance, angle = o.max_drift_m, float(np.radians(o.max_tilt_deg))
    scale = o.reward.d_drift_scale
    return EarlyStop(distance=distance, angle=angle, drift=scale * distance, tilt=scale * angle)

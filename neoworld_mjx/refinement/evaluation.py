"""Placement, settling, rollouts and scoring of a population, on the host and its devices."""

import time
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from ..cache import computes_on_cpu
from ..config import RefineOptions
from ..physics.array_types import AnyArray
from ..physics.engine import EarlyStop, Engine, Rollout, zero_duration_rollout
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from ..physics.placed import Placed, measure_in_chunks, measure_settled, place_in_chunks
from ..physics.rest import settle
from ..physics.scene_arrays import SceneArrays, pad_axis, pad_objects
from ..physics.sharding import REPLICATED, SHARDED, device_mesh, put
from ..spec import SceneSpec
from .choosing import Round
from .objective import Objective, Scores, evaluate


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
    objective: Objective
    clock: dict[str, float]
    """Seconds spent on each step; updated in place."""

    def place(self, layouts: Layout) -> Placed:
        """Place a population, settle it if enabled, and measure the result."""
        began = time.perf_counter()
        if computes_on_cpu():
            start = place_in_chunks(self.arrays, layouts)
        else:
            start = self.on_devices(SceneArrays.place, self.arrays, layouts)
        end, placing = start, time.perf_counter() - began
        if self.options.settle.enabled:
            ends = settle(self.scene, self.unpadded(start), self.engine, self.options.settle)
            end = jax.tree.map(_with_first_objects, start, ends)
        settling = time.perf_counter() - began - placing
        placed = self.measure(start, end)
        self.clock["settle"] += settling
        self.clock["score"] += time.perf_counter() - began - settling
        return placed

    def measure(self, start: Poses, end: Poses) -> Placed:
        """Measure a population, given the placed poses and the settled poses."""
        start, end = pad_objects((start, end), self.padded.count)
        if computes_on_cpu():
            placed = measure_in_chunks(self.padded, start, end)
        else:
            placed = self.on_devices(measure_settled, self.padded, start, end)
        count = self.arrays.count
        if count == self.padded.count:
            return placed
        placed = jax.tree.map(lambda x: np.asarray(x)[:, :count], placed)
        return eqx.tree_at(lambda p: p.depth, placed, placed.depth[:, :, :count])

    def roll_out(self, poses: Poses) -> Rollout:
        """Roll out candidates from their poses; the result is on the host and not padded."""
        began, r = time.perf_counter(), self.options.rollout
        if r.duration_s:
            rollout = self.engine.rollout(
                self.scene,
                self.unpadded(poses),
                duration=r.duration_s,
                record_every=r.record_every_s,
                early_stop=early_stop_rule(self.options) if r.early_stop else None,
            )
        else:
            rollout = zero_duration_rollout(self.scene, self.unpadded(poses))
        rollout = jax.device_get(rollout)
        self.clock["rollout"] += time.perf_counter() - began
        return rollout

    def score(
        self, layouts: Layout, placed: Placed, rollout: Rollout, s_sem: np.ndarray | None = None
    ) -> Scores:
        """Score a population; `s_sem` by a model replaces the geometric S_sem."""
        began = time.perf_counter()
        padded = pad_rollout(rollout, self.arrays)
        scores = self.on_devices(
            evaluate, self.arrays, layouts, placed, padded, self.objective, s_sem
        )
        self.clock["score"] += time.perf_counter() - began
        return scores

    def score_before_physics(self, layouts: Layout, placed: Placed) -> Scores:
        """Score candidates as if no object moved, with the geometric S_sem."""
        motionless = zero_duration_rollout(self.arrays, placed.poses)
        return jax.device_get(evaluate(self.arrays, layouts, placed, motionless, self.objective))

    def score_initial(self, scene: SceneSpec, layout: Layout) -> Round:
        """Return an iteration whose only candidate is the initial layout at its settled poses.

        Args:
            scene: the final scene of the initial layout.
            layout: the initial layout, padded.
        """
        rest = self.settled_poses(scene, layout)
        return self.unpadded_round(layout, rest, self._score_single(layout, rest, rest))

    def score_final(
        self, scene: SceneSpec, layout: Layout, s_sem: float | None = None
    ) -> dict[str, float]:
        """Return `absolute`, `merit` and the terms of the final scene of a layout, by name.

        The candidate is settled again for the final check, with a smaller time step than in the
        search, so the final scene is close to the candidate, but not equal to it.

        Args:
            scene: the final scene.
            layout: its layout, not padded.
            s_sem: S_sem of the candidate by a model. If None, the geometric S_sem is computed.
        """
        layout = pad_objects(layout, self.arrays.count)
        start = place_in_chunks(self.arrays, layout)
        by_model = None if s_sem is None else np.array([s_sem], np.float32)
        rest = self.settled_poses(scene, layout)
        return named_scores(self._score_single(layout, start, rest, by_model))

    def settled_poses(self, scene: SceneSpec, layout: Layout) -> Poses:
        """Return the padded poses of a settled scene, with the scales of the padded layout."""
        scale = np.exp(np.asarray(layout.log_scale)[:, : len(self.scene.names)])
        rest = pad_objects(self.scene.poses(scene, scale), self.arrays.count)
        return jax.tree.map(np.float32, rest)

    def _score_single(
        self, layout: Layout, start: Poses, rest: Poses, s_sem: np.ndarray | None = None
    ) -> Scores:
        """Roll out and score one candidate from its settled poses.

        The candidate is repeated to the population size, so that functions which were compiled for
        the search are reused.
        """
        rows = np.zeros(self.options.cem.population, int)
        repeat = lambda tree: jax.tree.map(lambda x: np.asarray(x)[rows], tree)
        single = self.roll_out(rest)
        rollout = eqx.tree_at(lambda x: x.time, repeat(single), single.time)
        if computes_on_cpu():
            placed = repeat(self.measure(start, rest))
        else:
            placed = self.measure(repeat(start), repeat(rest))
        s_sem = None if s_sem is None else repeat(s_sem)
        scores = self.score(repeat(layout), placed, rollout, s_sem)
        return jax.tree.map(lambda x: np.asarray(x)[:1], scores)

    def unpadded_round(self, layouts: Layout, poses: Poses, scores: Scores) -> Round:
        """Return an iteration from which padded objects are removed."""
        by_object = lambda s: (s.drift, s.depth, s.rested)
        scores = eqx.tree_at(by_object, scores, self.unpadded(by_object(scores)))
        return Round(self.unpadded(layouts), self.unpadded(poses), scores)

    def unpadded(self, tree: Any) -> Any:
        """Remove padded objects from the arrays [pop, object, ...] of a pytree, on the host."""
        return jax.tree.map(lambda x: np.asarray(x)[:, : len(self.scene.names)], tree)

    def on_devices(self, fn: Any, scene: SceneArrays, *args: Any) -> Any:
        """Call `fn(scene, *args)` with the population sharded over the devices."""
        return jax.device_get(fn(scene, *shard(args, self.options.cem.population)))


def named_scores(scores: Scores) -> dict[str, float]:
    """Return `absolute`, `merit` and the terms of the only candidate, by name."""
    values = {"absolute": scores.absolute, "merit": scores.merit, **scores.terms}
    return {name: float(np.asarray(x)[0]) for name, x in values.items()}


def shard(tree: Any, length: int) -> Any:
    """Shard the arrays whose leading axis has a given length over the devices; replicate the rest.

    The devices are all local ones, or one if `jax.default_device` is set. If there is one device,
    or if the length is not a multiple of the number of devices, return the tree unchanged.
    """
    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    mesh = device_mesh(jax.local_devices() if chosen is None else jax.local_devices()[:1])
    if mesh is None or length < 1 or length % mesh.size:
        return tree
    arrays, rest = eqx.partition(tree, eqx.is_array)
    spec_of = lambda x: SHARDED if np.shape(x)[:1] == (length,) else REPLICATED
    return eqx.combine(jax.tree.map(lambda x: put(x, mesh, spec_of(x)), arrays), rest)


def _with_first_objects(whole: np.ndarray, part: AnyArray) -> np.ndarray:
    """Return a copy of an array [pop, object, ...] whose first objects are those of `part`."""
    copied = np.array(whole)
    copied[:, : np.shape(part)[1]] = part
    return copied


def pad_rollout(rollout: Rollout, scene: SceneArrays) -> Rollout:
    """Pad a rollout on the host to the size of a padded scene; padded objects do not move."""
    objects, joints = scene.count, len(scene.joint_object)
    start = pad_objects(rollout.start, objects)

    def pad(x: AnyArray, length: int) -> np.ndarray:
        return np.moveaxis(pad_axis(np.moveaxis(np.asarray(x), 2, 0), length), 0, 2)

    return Rollout(
        time=rollout.time,
        pos=pad(rollout.pos, objects),
        quat=pad(rollout.quat, objects),
        joint_shift=pad(rollout.joint_shift, joints),
        status=rollout.status,
        start=start,
        steps=rollout.steps,
    )


def early_stop_rule(o: RefineOptions) -> EarlyStop:
    """Return the rule by which rollouts stop early, from the bounds and the cap of D_drift.

    Drift beyond the cap changes neither the validity nor the reward of a candidate.
    """
    distance, angle = o.max_drift_m, float(np.radians(o.max_tilt_deg))
    cap = o.reward.d_drift_cap
    return EarlyStop(distance=distance, angle=angle, drift=cap * distance, tilt=cap * angle)

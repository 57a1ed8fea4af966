"""Baselines of a refinement, as options of its loop: Algorithm 1, random search and CMA-ES."""

import math

import jax
import mujoco
import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.engine import EarlyStop, Rollout, Schedule, record_steps
from neoworld_mjx.physics.layout import Poses
from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.physics.model import SceneModel
from neoworld_mjx.physics.recorder import Recorder, in_chunks
from neoworld_mjx.spec import SceneSpec
from neoworld_mjx.spec.scene import rearranged

from ..engines.verdicts import started

CMA_POPULATION = 16
"""Population of CMA-ES; 4 + 3 ln n is 13 to 15 for its 16 to 40 variables."""


class OneByOne:
    """Engine that compiles and steps one candidate after another."""

    name = "sequential"

    def rollout(
        self,
        scene: SceneModel,
        poses: Poses,
        *,
        duration: float = 1.0,
        record_every: float = 0.1,
        early_stop: EarlyStop | None = None,
    ) -> Rollout:
        """Simulate every candidate on one thread; see `Engine.rollout`. Nothing stops early."""
        timestep = scene.static.mjm.opt.timestep
        schedule = Schedule(*record_steps(timestep, duration, record_every))
        poses = jax.tree.map(lambda leaf: np.asarray(leaf, float), poses)

        def run(one: Poses) -> Rollout:
            recorder = Recorder(scene.static, one, schedule)
            model, data = started(to_mjspec(_placed_scene(scene, one), timestep=timestep))
            for t in range(schedule.records):
                mujoco.mj_step(model, data, nstep=schedule.every)
                recorder.record(t, data.qpos[None], None, None)
                if not len(recorder.active):
                    break
            return recorder.rollout()

        return in_chunks(scene.static, poses, 1, schedule, run)


def _placed_scene(scene: SceneModel, poses: Poses) -> SceneSpec:
    """Return the scene of a single candidate, with its objects placed in the world without
    parents."""
    alone = {"parent": None, "parent_link": None, "xy": (0.0, 0.0), "yaw": 0.0}
    objects = tuple(
        obj.model_copy(update={**alone, "base_tilt": tuple(poses.quat[0, i].tolist())})
        for i, obj in enumerate(scene.spec.objects)
    )
    flat = scene.spec.model_copy(update={"objects": objects})
    yaw, pos = np.zeros(len(objects)), poses.pos[0]
    return rearranged(flat, pos[:, :2], yaw, np.log(poses.scale[0]), pos[:, 2])


def algorithm1(options: RefineOptions) -> RefineOptions:
    """Return the options of Algorithm 1 as in the paper, with the given N, T, weights and terms."""
    o = options
    cem = {"first": 0, "credit": "scene", "prune": False, "zero_candidate": False}
    cem |= {"sigma_floor": 0.0, "smoothing": 0.0, "patience": 1}
    return o.model_copy(
        update={
            "cem": o.cem.model_copy(update=cem),
            "descent": o.descent.model_copy(update={"warm_steps": 0, "project": "never"}),
            "reward": o.reward.model_copy(update={"normalisation": "iteration"}),
            "rollout": o.rollout.model_copy(update={"early_stop": False}),
            "settle": "never",
        }
    )


def with_budget(options: RefineOptions, optimizer: str, rollouts: int) -> RefineOptions:
    """Return the options of another optimizer with at least as many rollouts, all of them made.

    Random search draws `cem.batch` candidates at once or a few less, CMA-ES CMA_POPULATION. Neither
    stops before its budget is spent.

    Args:
        options: of the refinement that it is compared with.
        optimizer: `random` or `cma_es`.
        rollouts: of that refinement.
    """
    population = CMA_POPULATION if optimizer == "cma_es" else options.cem.batch
    iterations = max(1, math.ceil(rollouts / population))
    if optimizer == "random":
        population = math.ceil(rollouts / iterations)
    cem = {"population": max(2, population), "iterations": iterations, "patience": iterations + 1}
    cem |= {"first": 0, "credit": "scene", "prune": False}
    return options.model_copy(
        update={"optimizer": optimizer, "cem": options.cem.model_copy(update=cem)}
    )

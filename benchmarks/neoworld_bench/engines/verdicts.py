"""Stability verdicts of engines, and of C MuJoCo on the recompiled scene of each candidate."""

import time
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.engine import Rollout, RolloutStatus, record_steps
from neoworld_mjx.physics.layout import Layout, Poses
from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.physics.model import FREE, SceneModel
from neoworld_mjx.search.rewards import drifts
from neoworld_mjx.spec.pose import angle_between

_BOUNDS = RefineOptions()
DISTANCE, ANGLE = _BOUNDS.max_drift_m, float(np.radians(_BOUNDS.max_tilt_deg))
"""Bounds of stability [m], [rad]."""
NEAR = (0.5, 2.0)
"""Multiples of a bound between which a layout is borderline and counted separately, as a
perturbation of 1e-13 can change its verdict."""
RECORD_EVERY_S = 0.1
"""Time between the poses on which the loop's verdicts are based [s]."""


def motion(scene: SceneModel, rollout: Rollout) -> Float[np.ndarray, " pop"]:
    """Return each candidate's largest motion in units of the bounds; inf if it failed."""
    displacement, rotation = (np.asarray(x) for x in drifts(scene, rollout))
    ratios = np.maximum(displacement / DISTANCE, rotation / ANGLE)
    most = np.where(np.asarray(scene.movable), ratios, 0.0).max(axis=1)
    return np.where(np.asarray(rollout.status) == RolloutStatus.FAILED, np.inf, most)


class Loop(NamedTuple):
    """Results of the loop over the first candidates of a population."""

    motion: Float[np.ndarray, " some"]
    """Largest motion in units of the bounds."""
    seconds: float
    """Time of compiling and simulating all of them [s]."""

    @property
    def candidates_per_s(self) -> float:
        """Rate of the loop, compiling included."""
        return len(self.motion) / self.seconds


def naive_loop(
    scene: SceneModel,
    layouts: Layout,
    poses: Poses,
    *,
    duration: float = 1.0,
    budget: float = float("inf"),
) -> Loop:
    """Recompile the scene of each candidate with MuJoCo and step it, on one thread.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        poses: their poses in double precision.
        duration: simulated time [s].
        budget: time after which no further candidate starts [s].
    """
    timestep = scene.static.mjm.opt.timestep
    records, every = record_steps(timestep, duration, RECORD_EVERY_S)
    moved: list[float] = []
    spent, began = 0.0, time.perf_counter()
    for k in range(poses.scale.shape[0]):
        if moved and time.perf_counter() - began > budget:
            break
        spec = to_mjspec(scene.apply(layouts, k, poses), timestep=timestep)
        t0 = time.perf_counter()
        model, path = _simulated(spec, records, every)
        spent += time.perf_counter() - t0
        moved.append(_farthest(model, path))
    return Loop(np.array(moved), spent)


def _simulated(
    spec: mujoco.MjSpec, records: int, every: int
) -> tuple[mujoco.MjModel, Float[np.ndarray, "record nq"]]:
    """Return a compiled scene, and its coordinates at the start and at each record."""
    model = spec.compile()
    # As in compile_scene: a diverged state must not be reset.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    data = mujoco.MjData(model)
    if model.nkey:
        data.qpos[:] = model.key("start").qpos
    path = np.empty((records + 1, model.nq))
    path[0] = data.qpos
    for t in range(records):
        mujoco.mj_step(model, data, nstep=every)
        path[t + 1] = data.qpos
    return model, path


def _farthest(model: mujoco.MjModel, path: np.ndarray) -> float:
    """Return the largest motion along a path in units of the bounds; inf if it is not finite."""
    free = model.jnt_qposadr[model.jnt_type == FREE]
    if not np.isfinite(path).all():
        return float("inf")
    if not len(free):
        return 0.0
    seven = path[:, free[:, None] + np.arange(7)]
    displacement = np.linalg.norm(seven[..., :3] - seven[:1, :, :3], axis=-1)
    rotation = angle_between(seven[:1, :, 3:], seven[..., 3:])
    return float(max(displacement.max() / DISTANCE, rotation.max() / ANGLE))


class Compared(NamedTuple):
    """Comparison of two verdicts on the same layouts."""

    near: Bool[np.ndarray, " pop"]
    """True if the reference is within `NEAR` of a bound."""
    same: Bool[np.ndarray, " pop"]

    def share(self, *, near: bool) -> float | None:
        """Share of equal verdicts among the layouts near a bound, or among all others."""
        chosen = self.near == near
        return float(self.same[chosen].mean()) if chosen.any() else None


def compare(reference: Float[np.ndarray, " pop"], other: Float[np.ndarray, " pop"]) -> Compared:
    """Compare verdicts; a motion is divided by its stability bound, and below 1 is stable.

    Only the reference's motion decides which layouts are borderline.
    """
    near = (reference > NEAR[0]) & (reference < NEAR[1])
    return Compared(near, (reference < 1.0) == (other < 1.0))

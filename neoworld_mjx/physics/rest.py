"""Resting states: candidates settle under springs that fade, and then fall freely.

All scenes that are settled or checked go through `rest`: the aligned scene, the candidates that
receive a final check, the final alignment, and the measures of a scene as it is (without springs).
The search calls its two halves, `settle` and a rollout, because it scores the settled poses.
"""

import copy
import weakref
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import jax
import mujoco
import numpy as np
from jaxtyping import Float, Int
from mujoco.batch import Batch, SimulationError

from ..config import SettleOptions
from ..spec import SceneSpec
from ..spec.pose import angle_between
from .colliders import object_depths
from .engine import EarlyStop, Engine, RolloutStatus, unplaceable
from .guidance import INTERVAL_S, Guidance
from .layout import Poses
from .model import FREE, CompiledScene, StaticScene, compile_for_simulation, is_rotational
from .native import NativeEngine, open_batch
from .placed import settling_displacement
from .recorder import DIVERGED, read_states

HOLD_RATE = 1e5
"""Damping of joints while objects settle, divided by the joint's inertia [1/s]. If gravity
accelerates a joint by a, the joint moves with velocity a / HOLD_RATE."""
AT_REST: dict[str, Any] = {
    "distance": 0.0067, "angle": 0.058, "drift": 1e3, "tilt": 1e3, "linger": 0.12, "anywhere": True
}  # fmt: skip
"""Conditions of `EarlyStop` under which a settled candidate stops early."""
STILL = EarlyStop(speed=0.001)
"""Conditions under which a free fall ends with `stop_early`: what creeps faster falls on, so at
most 2 mm of drift are missing in the 2 s of the final check."""
CompiledT = TypeVar("CompiledT", bound=CompiledScene)
CHUNK = 64
"""Number of candidates that fall at once, whose states after every step are kept."""
STOPPING_CHUNK = 1024
"""The same with `stop_early`, whose states are kept every 20 ms."""
Depths = dict[tuple[str, str], float]
"""Penetration depth of each pair of objects that penetrate each other [m]."""


class Rested(NamedTuple):
    """Candidates after settling, and their motion in a free fall from the settled poses."""

    poses: Poses
    """Settled poses; the given ones without settling. In double precision."""
    moved: Float[np.ndarray, "pop object"]
    """Displacement by settling, relative to the bounds of `settling_displacement`."""
    drift: Float[np.ndarray, "pop object"]
    """Largest displacement in the free fall [m]."""
    tilt: Float[np.ndarray, "pop object"]
    """Largest rotation in the free fall [rad]."""
    joint_motion: Float[np.ndarray, "pop joint"]
    """Largest motion of each of `StaticScene.joints` in the free fall [rad or m]."""
    depths: tuple[Depths, ...]
    """Depths at the settled poses, by candidate."""
    end_depths: tuple[Depths, ...]
    """Depths at the end of the free fall, when contacts bear weight; empty if it failed."""
    status: Int[np.ndarray, " pop"]
    """OK; FAILED if the free fall diverged; TRUNCATED if MuJoCo's memory does not hold its
    contacts."""


def rest(
    scene: CompiledScene,
    start: Poses,
    *,
    hold: SettleOptions | None,
    free_s: float,
    engine: Engine | None = None,
    placed: Poses | None = None,
    stop_early: bool = False,
) -> Rested:
    """Settle candidates under springs that fade, and let them fall freely from there.

    The free fall starts without velocities. Its motion is the largest of any step, and its depths
    are exact, whatever the precision of the engine that settles: both are computed by MuJoCo in C.
    With `stop_early`, for many candidates, the engine also simulates the free fall, which ends at
    rest as in the search; only the depths are then exact.

    Args:
        scene: the compiled scene, which sets the time step.
        start: poses from which the candidates settle.
        hold: duration and springs of the settling; if None, the candidates fall from `start`.
        free_s: duration of the free fall [s].
        engine: engine that settles the candidates, and with `stop_early` lets them fall; by default
            `native`.
        placed: poses to which `Rested.moved` is relative; by default `start`.
        stop_early: if True, candidates at rest are not simulated to the end; see `EarlyStop`.

    Raises:
        EngineError: the engine cannot simulate the scene.
    """
    engine = engine or NativeEngine()
    start = jax.tree.map(lambda leaf: np.asarray(leaf, float), start)
    end = start
    if hold is not None:
        end = settle(scene, start, engine, hold, stop_early=stop_early)
        end = jax.tree.map(lambda leaf: np.asarray(leaf, float), end)
    placed = start if placed is None else placed
    moved = np.asarray(settling_displacement(scene.static, placed, end, np))
    pop, objects = end.scale.shape
    drift, tilt = np.full((2, pop, objects), np.nan)
    joint_motion = np.full((pop, len(scene.static.joints)), np.nan)
    status = np.full(pop, int(RolloutStatus.FAILED))
    depths: list[Depths] = [{} for _ in range(pop)]
    end_depths = list(depths)
    rows = np.flatnonzero(~unplaceable(end))
    fall, size = (_fall_to_rest, STOPPING_CHUNK) if stop_early else (_whole_fall, CHUNK)
    for first in range(0, len(rows), size):
        chunk = rows[first : first + size]
        (pos, quat, shift), status[chunk], ends = fall(scene, end[chunk], free_s, engine)
        away = pos - end.pos[chunk, None]
        drift[chunk] = np.linalg.norm(away, axis=-1).max(axis=1)
        tilt[chunk] = angle_between(end.quat[chunk, None], quat).max(axis=1)
        joint_motion[chunk] = shift.max(axis=1)
        for k, at_start, at_end in zip(chunk, _depths(scene, end[chunk]), ends, strict=True):
            depths[k], end_depths[k] = at_start, at_end
    return Rested(end, moved, drift, tilt, joint_motion, tuple(depths), tuple(end_depths), status)


Fall = tuple[tuple[np.ndarray, np.ndarray, np.ndarray], Int[np.ndarray, " pop"], list[Depths]]
"""Positions, rotations and joint shifts of candidates over time; their status; and their depths at
the end of the fall, empty if it failed."""


def _whole_fall(scene: CompiledScene, start: Poses, free_s: float, _: Engine) -> Fall:
    """Simulate every step of a free fall in C MuJoCo."""
    batch = open_batch(scene, start)
    steps = max(1, round(free_s / float(scene.static.mjm.opt.timestep)))
    qpos, status = _simulate(batch, steps)
    ends = _end_depths(scene, start, status, qpos[:, -1])
    return read_states(scene.static, start, qpos), status, ends


def _fall_to_rest(scene: CompiledScene, start: Poses, free_s: float, engine: Engine) -> Fall:
    """Simulate a free fall that ends at rest. Joints have their initial positions in the depths."""
    rollout = jax.device_get(
        engine.rollout(scene, start, duration=free_s, record_every=INTERVAL_S, early_stop=STILL)
    )
    stopped = np.isin(rollout.status, (int(RolloutStatus.SETTLED), int(RolloutStatus.DRIFTED)))
    status = np.where(stopped, int(RolloutStatus.OK), rollout.status)
    end = replace(start, pos=rollout.pos[:, -1], quat=rollout.quat[:, -1])
    motion = rollout.pos, rollout.quat, rollout.joint_shift
    return motion, status, _end_depths(scene, end, status)


def _simulate(
    batch: Batch, steps: int
) -> tuple[Float[np.ndarray, "pop step nq"], Int[np.ndarray, " pop"]]:
    """Simulate a batch in one call; return qpos after every step, and the status of each one."""
    qpos = np.full((batch.nsim, steps, batch.model.nq), np.nan)
    refused = np.zeros(0, int)
    try:
        batch.rollout(steps, record=("qpos",), out={"qpos": qpos})
    except SimulationError as error:  # MuJoCo's stack is full; the others are simulated
        refused = error.ids
    raised = lambda *kinds: batch.warning[:, [int(kind) for kind in kinds], 1].any(axis=1)
    w = mujoco.mjtWarning
    # Comparisons with NaN are false.
    failed = ~(np.abs(qpos) < DIVERGED).all(axis=(1, 2))
    failed |= raised(w.mjWARN_BADQPOS, w.mjWARN_BADQVEL, w.mjWARN_BADQACC)
    status = np.where(failed, int(RolloutStatus.FAILED), int(RolloutStatus.OK))
    status[raised(w.mjWARN_CONTACTFULL, w.mjWARN_CNSTRFULL)] = int(RolloutStatus.TRUNCATED)
    status[refused] = int(RolloutStatus.TRUNCATED)
    return qpos, status


def _end_depths(
    scene: CompiledScene,
    poses: Poses,
    status: Int[np.ndarray, " pop"],
    qpos: Float[np.ndarray, "pop nq"] | None = None,
) -> list[Depths]:
    """Return the depths of candidates whose fall did not fail."""
    rows = np.flatnonzero(status == int(RolloutStatus.OK))
    ends: list[Depths] = [{} for _ in status]
    found = _depths(scene, poses[rows], None if qpos is None else qpos[rows])
    for k, depths in zip(rows, found, strict=True):
        ends[k] = depths
    return ends


def _depths(
    scene: CompiledScene, poses: Poses, qpos: Float[np.ndarray, "pop nq"] | None = None
) -> list[Depths]:
    """Return the depths of candidates at their poses, or in the states `qpos`."""
    model, data = copy.copy(scene.static.mjm), mujoco.MjData(scene.static.mjm)
    found: list[Depths] = []
    for first in range(0, len(poses.scale), CHUNK):
        batch = open_batch(scene, poses[first : first + CHUNK])
        states = batch.bind("qpos") if qpos is None else qpos[first : first + CHUNK]
        for k, state in enumerate(states):
            batch.get_model(k, model)
            data.qpos[:] = state
            mujoco.mj_kinematics(model, data)
            found.append(object_depths(scene.spec, model, data))
    return found


def settle(
    scene: CompiledScene, poses: Poses, engine: Engine, o: SettleOptions, *, stop_early: bool = True
) -> Poses:
    """Settle placed candidates under guidance.

    A candidate whose simulation fails keeps its placed poses.

    Args:
        scene: the compiled scene.
        poses: placed poses of the candidates' objects.
        engine: the engine.
        o: duration, springs and speed limit.
        stop_early: if True, the simulation of a candidate may end when the springs have faded and
            its objects are at rest or creep.

    Returns:
        Settled poses, on the host. `height` is the height of the placed poses.
    """
    rollout = jax.device_get(
        engine.rollout(
            with_damped_joints(scene),
            poses,
            duration=o.duration_s,
            record_every=o.duration_s,
            early_stop=EarlyStop(after=o.fade_s, **AT_REST) if stop_early else None,
            guidance=Guidance(o.rate, o.fade_s),
        )
    )
    failed = np.isin(rollout.status, (int(RolloutStatus.FAILED), int(RolloutStatus.TRUNCATED)))
    start: Poses = jax.tree.map(np.asarray, poses)
    unsettled = failed[:, None, None]
    return Poses(
        np.where(unsettled, start.pos, rollout.pos[:, -1]),
        np.where(unsettled, start.quat, rollout.quat[:, -1]),
        start.scale,
        start.height,
        start.variation,
    )


def with_damped_joints(scene: CompiledT) -> CompiledT:
    """Return a scene in which damping keeps all joints in place, at any scale of the objects."""
    if not len(scene.static.joints):
        return scene
    damped = _damped_joints.get(scene.static)
    if damped is None:
        damped = _damped_joints[scene.static] = _static_with_damped_joints(scene.static)
    return replace(scene, static=damped)


_damped_joints: "weakref.WeakKeyDictionary[StaticScene, StaticScene]" = weakref.WeakKeyDictionary()


def _static_with_damped_joints(static: StaticScene) -> StaticScene:
    model = copy.copy(static.mjm)
    of_joint = model.jnt_type[model.dof_jntid] != FREE
    model.dof_damping[of_joint] = HOLD_RATE * model.dof_M0[of_joint]
    rotational = np.array([is_rotational(model, dof) for dof in range(model.nv)])
    mass = static.powers.body_mass[model.dof_bodyid]
    power = np.where(of_joint, mass + np.where(rotational, 2.0, 0.0), static.powers.dof_damping)
    powers = static.powers._replace(dof_damping=power)
    return replace(static, mjm=model, powers=powers)


def settle_scene(scene: SceneSpec, o: SettleOptions) -> SceneSpec:
    """Return a scene whose movable objects have settled in C MuJoCo.

    If the simulation diverges, return the scene unchanged.
    """
    world = compile_for_simulation(scene)
    return world.scene_at(settle(world, world.poses(), NativeEngine(), o))

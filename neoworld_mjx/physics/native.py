"""Rollouts on all cores with C MuJoCo: `mujoco.batch.Batch` with per-candidate model fields.

Scenes of primitives expand the fields that differ; a mesh's vertices are shared by a model's
copies in a batch, so scenes with convex pieces run on a ring of model copies scaled in place.
"""

import copy

import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from .engine import EarlyStop, Rollout, RolloutStatus, record_steps
from .layout import Either, Layout, Poses, compose_poses, heights
from .model import FREE, MESH, SceneModel, leaves, mesh_object

CHUNK, MESH_CHUNK = 1024, 256


class NativeEngine:
    """C MuJoCo on the CPU; nothing to compile, bit-identical at any number of threads."""

    name = "native"

    def __init__(self, threads: int = 0):
        """Use `threads` threads; 0 takes all cores."""
        self.threads = threads

    def rollout(
        self,
        scene: SceneModel,
        layouts: Layout,
        *,
        duration: float = 1.0,
        record_every: float = 0.1,
        early_stop: EarlyStop | None = None,
    ) -> Rollout:
        """Simulate every candidate; see `Engine.rollout`."""
        poses = exact_poses(scene, layouts)
        records, every = record_steps(scene.host.mjm.opt.timestep, duration, record_every)
        layouts = _on_host(layouts)
        pop, size = poses.scale.shape[0], MESH_CHUNK if has_meshes(scene) else CHUNK
        parts = []
        for first in range(0, pop, size):
            cut = slice(first, min(first + size, pop))
            chosen = Poses(poses.pos[cut], poses.quat[cut], poses.scale[cut], poses.height[cut])
            few = Layout(layouts.xy[cut], layouts.yaw[cut], layouts.log_scale[cut])
            batch = open_batch(scene, few, chosen, self.threads)
            parts.append(_run(scene, batch, chosen, records, every, early_stop))
        pos, quat, status, steps = (np.concatenate(column) for column in zip(*parts, strict=True))
        dt = scene.host.mjm.opt.timestep
        f32 = lambda x: jnp.asarray(x, jnp.float32)
        return Rollout(
            time=f32(np.arange(1, records + 1) * every * dt),
            pos=f32(pos),
            quat=f32(quat),
            status=jnp.asarray(status),
            start=Poses(f32(poses.pos), f32(poses.quat), f32(poses.scale), f32(poses.height)),
            steps=jnp.asarray(steps),
        )


def exact_poses(scene: SceneModel, layouts: Layout) -> Poses:
    """Place candidates in double precision (NumPy), at the heights that `place` snaps to."""
    height = np.asarray(heights(scene.host.arrangement, layouts), float)
    return compose_poses(scene.host.arrangement, _on_host(layouts), height, np)


def has_meshes(scene: SceneModel) -> bool:
    """Whether any collider is a convex piece given by its corners."""
    return bool(np.any(scene.host.mjm.geom_type == MESH))


def open_batch(scene: SceneModel, layouts: Layout, poses: Poses, threads: int = 0) -> Batch:
    """Build a batch whose simulation k runs candidate k's model, in its start state.

    Args:
        scene: the compiled scene.
        layouts: the candidates, NumPy leaves.
        poses: where they stand, NumPy leaves in double precision.
        threads: 0 takes all cores.
    """
    fields = leaves(scene, layouts, poses, np)
    qpos = fields.pop("qpos")
    batch = Batch(scene.host.mjm, nsim=len(qpos), nthread=threads)
    if has_meshes(scene):
        batch.set_models(model_ring(scene, fields, poses.scale))
    else:
        for name, values in fields.items():
            batch.expand(name)[:] = values.reshape(batch.expand(name).shape)
        batch.set_const()
    batch.bind("qpos")[:] = qpos
    return batch


def model_ring(scene: SceneModel, fields: dict, scale: Either) -> list[mujoco.MjModel]:
    """Copy the scene's model once a candidate and scale each copy, meshes included."""
    base, owner = scene.host.mjm, mesh_object(scene)
    data = mujoco.MjData(base)
    ring = []
    for k in range(len(scale)):
        model = copy.copy(base)
        for name, values in fields.items():
            target = getattr(model, name)
            target[:] = values[k].reshape(target.shape)
        for mesh in np.flatnonzero(owner >= 0):
            s = scale[k, owner[mesh]]
            if s == 1.0:
                continue
            at, n = base.mesh_vertadr[mesh], base.mesh_vertnum[mesh]
            model.mesh_vert[at : at + n] = base.mesh_vert[at : at + n] * s
            model.mesh_pos[mesh] = base.mesh_pos[mesh] * s
            if base.mesh_bvhnum[mesh]:
                at, n = base.mesh_bvhadr[mesh], base.mesh_bvhnum[mesh]
                model.bvh_aabb[at : at + n] = base.bvh_aabb[at : at + n] * s
        mujoco.mj_setConst(model, data)
        ring.append(model)
    return ring


def _run(
    scene: SceneModel,
    batch: Batch,
    start: Poses,
    records: int,
    every: int,
    rule: EarlyStop | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    m = scene.host.mjm
    free = np.flatnonzero(m.jnt_type == FREE)
    moving, adr = scene.host.jnt_object[free], m.jnt_qposadr[free]
    pop, objects = start.scale.shape
    pos = np.broadcast_to(start.pos[:, None], (pop, records, objects, 3)).copy()
    quat = np.broadcast_to(start.quat[:, None], (pop, records, objects, 4)).copy()
    status = np.full(pop, int(RolloutStatus.OK), np.int32)
    steps = np.zeros(pop, np.int32)
    calm = np.zeros(pop, np.int32)
    qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
    qacc = batch.bind("qacc") if m.nv else qvel
    active = np.arange(pop)
    for t in range(records):
        if len(active) and m.nv:
            failed = _step(batch, active, every)
            bad = failed | ~np.isfinite(qpos[active]).all(axis=1)
            status[active[bad]] = int(RolloutStatus.FAILED)
            active = active[~bad]
            steps[active] += every
            for o, a in zip(moving, adr, strict=True):
                pos[active, t:, o] = qpos[active, None, a : a + 3]
                quat[active, t:, o] = qpos[active, None, a + 3 : a + 7]
        if rule is None or not len(active):
            continue
        quiet = (np.abs(qvel[active]).max(axis=1, initial=0) < rule.speed) & (
            np.abs(qacc[active]).max(axis=1, initial=0) < rule.acceleration
        )
        calm[active] = np.where(quiet, calm[active] + 1, 0)
        settled = (calm[active] >= 2) & ((t + 1) * every * m.opt.timestep >= rule.after)
        far, turned = drift(pos[active, t], quat[active, t], start.pos[active], start.quat[active])
        drifted = (far.max(axis=1) > rule.drift) | (turned.max(axis=1) > rule.tilt)
        status[active[settled]] = int(RolloutStatus.SETTLED)
        status[active[drifted]] = int(RolloutStatus.DRIFTED)
        active = active[~(settled | drifted)]
    return pos, quat, status, steps


def _step(batch: Batch, active: np.ndarray, steps: int) -> np.ndarray:
    """Step some simulations; return which of them failed."""
    failed = np.zeros(len(active), bool)
    try:
        batch.step(ids=active.astype(np.int32), nstep=steps)
    except SimulationError as error:
        failed = np.isin(active, error.ids)
    return failed


def drift(
    pos: np.ndarray, quat: np.ndarray, pos0: Either, quat0: Either
) -> tuple[np.ndarray, np.ndarray]:
    """Distance [m] and angle [rad] of poses from others, shapes [..., 3] and [..., 4]."""
    dot = np.abs(np.sum(quat * quat0, axis=-1))
    return np.linalg.norm(pos - pos0, axis=-1), 2 * np.arccos(np.clip(dot, 0.0, 1.0))


def _on_host(layouts: Layout) -> Layout:
    return Layout(
        *(np.asarray(leaf, float) for leaf in (layouts.xy, layouts.yaw, layouts.log_scale))
    )

"""Rollouts on all cores with C MuJoCo: `mujoco.batch.Batch` with per-candidate model fields.

Scenes of primitives expand the fields that differ; a mesh's vertices are shared by a model's
copies in a batch, so scenes with convex pieces run on a ring of model copies scaled in place.
"""

import copy
import weakref

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco.batch import Batch, SimulationError

from .engine import EarlyStop, Rollout, RolloutStatus, on_cpu, quiet, record_steps, unplaceable
from .layout import Either, Layout, Poses, compose_poses, heights
from .model import FREE, MESH, Host, SceneModel, leaves, mesh_object

CHUNK = 1024
"""Most candidates simulated at once."""
SNAPPED = 8192
"""Objects of all candidates that are snapped at once; each takes about 30 KB meanwhile."""
RING_BYTES = 128 << 20
"""Memory that the copies of a model with meshes may take; it bounds the chunk, and is kept for the
next rollout of the same scene."""


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
        bad = unplaceable(poses)
        runs, layouts = _replaced(scene, poses, _on_host(layouts), bad)
        records, every = record_steps(scene.host.mjm.opt.timestep, duration, record_every)
        pop, size = poses.scale.shape[0], _chunk(scene)
        parts = []
        # Taken out while in use, so that a rollout in another thread makes copies of its own.
        ring = _rings.pop(scene.host, [])
        for first in range(0, pop, size):
            cut = slice(first, min(first + size, pop))
            chosen = Poses(runs.pos[cut], runs.quat[cut], runs.scale[cut], runs.height[cut])
            few = Layout(layouts.xy[cut], layouts.yaw[cut], layouts.log_scale[cut])
            batch = open_batch(scene, few, chosen, self.threads, ring)
            parts.append(_run(scene, batch, chosen, records, every, early_stop, bad[cut]))
        _rings[scene.host] = ring
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


_rings: "weakref.WeakKeyDictionary[Host, list[mujoco.MjModel]]" = weakref.WeakKeyDictionary()
"""Model copies of scenes with convex pieces; writing one anew takes a quarter of copying it."""


def exact_poses(scene: SceneModel, layouts: Layout) -> Poses:
    """Place candidates in double precision (NumPy), at the heights that `place` snaps to."""
    pop, objects = layouts.yaw.shape
    layouts = jax.tree.map(np.asarray, layouts)
    size = min(pop, max(1, SNAPPED // objects))
    parts = []
    for first in range(0, pop, size):
        # The last part is filled up, so that all have one shape and one compilation.
        index = np.minimum(np.arange(first, first + size), pop - 1)
        few = jax.tree.map(lambda leaf, i=index: leaf[i], layouts)
        with on_cpu():
            parts.append(np.asarray(_heights(scene, few), float)[: pop - first])
    height = np.concatenate(parts)
    with np.errstate(invalid="ignore", over="ignore"):  # such candidates fail; see unplaceable
        return compose_poses(scene.host.arrangement, _on_host(layouts), height, np)


def _chunk(scene: SceneModel) -> int:
    if not has_meshes(scene):
        return CHUNK
    return min(CHUNK, max(32, RING_BYTES // int(mujoco.mj_sizeModel(scene.host.mjm))))


@eqx.filter_jit
def _heights(scene: SceneModel, layouts: Layout) -> Float[Array, "pop object"]:
    return heights(scene.host.arrangement, layouts)


def has_meshes(scene: SceneModel) -> bool:
    """Whether any collider is a convex piece given by its corners."""
    return bool(np.any(scene.host.mjm.geom_type == MESH))


def open_batch(
    scene: SceneModel,
    layouts: Layout,
    poses: Poses,
    threads: int = 0,
    ring: list[mujoco.MjModel] | None = None,
) -> Batch:
    """Build a batch whose simulation k runs candidate k's model, in its start state.

    Args:
        scene: the compiled scene.
        layouts: the candidates, NumPy leaves.
        poses: where they stand, NumPy leaves in double precision.
        threads: 0 takes all cores.
        ring: copies of the scene's model to write over, when it has meshes; extended as needed. A
            batch made from the same ring before is void.
    """
    fields = leaves(scene, layouts, poses, np)
    qpos = fields.pop("qpos")
    batch = Batch(scene.host.mjm, nsim=len(qpos), nthread=threads)
    if has_meshes(scene):
        batch.set_models(model_ring(scene, fields, poses.scale, ring))
    else:
        for name, values in fields.items():
            batch.expand(name)[:] = values.reshape(batch.expand(name).shape)
        batch.set_const()
    batch.bind("qpos")[:] = qpos
    return batch


def model_ring(
    scene: SceneModel,
    fields: dict[str, np.ndarray],
    scale: Either,
    ring: list[mujoco.MjModel] | None = None,
) -> list[mujoco.MjModel]:
    """Write each candidate into its own copy of the scene's model, meshes included.

    Args:
        scene: the compiled scene.
        fields: of `leaves`.
        scale: of every object, shape [pop, object].
        ring: copies made before, to be written over; extended as needed.
    """
    base, pop = scene.host.mjm, len(scale)
    ring = [] if ring is None else ring
    ring.extend(copy.copy(base) for _ in range(pop - len(ring)))
    data = mujoco.MjData(base)
    fields = {name: v.reshape(pop, *getattr(base, name).shape) for name, v in fields.items()}
    padded = np.concatenate([scale, np.ones((pop, 1))], axis=1)
    mesh, vert, box = _mesh_owners(scene)
    mesh, vert, box = padded[:, mesh, None], padded[:, vert, None], padded[:, box, None]
    for k, model in enumerate(ring[:pop]):
        for name, values in fields.items():
            getattr(model, name)[:] = values[k]
        model.mesh_vert[:] = base.mesh_vert * vert[k]
        model.mesh_pos[:] = base.mesh_pos * mesh[k]
        model.bvh_aabb[:] = base.bvh_aabb * box[k]
        mujoco.mj_setConst(model, data)
    return ring[:pop]


def _mesh_owners(scene: SceneModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Object of each mesh, mesh vertex and bounding volume; -1 for what no scale acts on."""
    base, mesh = scene.host.mjm, mesh_object(scene)
    vert, box = np.full(base.nmeshvert, -1), np.full(base.nbvh, -1)
    for m, owner in enumerate(mesh):
        vert[base.mesh_vertadr[m] :][: base.mesh_vertnum[m]] = owner
        if base.mesh_bvhnum[m]:
            box[base.mesh_bvhadr[m] :][: base.mesh_bvhnum[m]] = owner
    return mesh, vert, box


def _run(
    scene: SceneModel,
    batch: Batch,
    start: Poses,
    records: int,
    every: int,
    rule: EarlyStop | None,
    bad: np.ndarray,
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
    status[bad] = int(RolloutStatus.FAILED)
    active = np.flatnonzero(~bad)
    for t in range(records):
        if len(active) and m.nv:
            failed = _step(batch, active, every)
            failed |= ~np.isfinite(qpos[active]).all(axis=1)
            status[active[failed]] = int(RolloutStatus.FAILED)
            active = active[~failed]
            steps[active] += every
            for o, a in zip(moving, adr, strict=True):
                pos[active, t:, o] = qpos[active, None, a : a + 3]
                quat[active, t:, o] = qpos[active, None, a + 3 : a + 7]
        if rule is None or not len(active):
            continue
        still = quiet(rule, scene.host.lever, qvel[active], qacc[active])
        calm[active] = np.where(still, calm[active] + 1, 0)
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


def _replaced(
    scene: SceneModel, poses: Poses, layouts: Layout, bad: np.ndarray
) -> tuple[Poses, Layout]:
    """Put the composed scene in the place of candidates that cannot be simulated."""
    if not bad.any():
        return poses, layouts
    pop, objects = bad.shape[0], poses.scale.shape[1]
    zero = _on_host(Layout.zero(1, objects))
    sound = exact_poses(scene, zero)
    mix = lambda leaf, safe: np.where(bad.reshape(pop, *(1,) * (leaf.ndim - 1)), safe, leaf)
    return jax.tree.map(mix, poses, sound), jax.tree.map(mix, layouts, zero)


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

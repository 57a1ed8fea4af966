"""Rollouts on all cores with C MuJoCo: `mujoco.batch.Batch` with per-candidate model fields.

Scenes of primitives expand the fields that differ; a mesh's vertices are shared by a model's
copies in a batch, so scenes with convex pieces run on a ring of model copies scaled in place.
"""

import copy
import itertools
import weakref

import jax
import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from .array_types import AnyArray
from .engine import EarlyStop, Rollout, RolloutStatus, record_steps
from .layout import Poses
from .model import MESH, SceneModel, StaticScene
from .model_fields import mesh_object, model_fields, owner_scale
from .recorder import Recorder, in_chunks

NATIVE_CHUNK = 1024
"""Most candidates simulated at once."""
SLEEPING_CHUNK = 256
"""The same where objects may sleep, for which MuJoCo keeps the data of each candidate."""
RING_BYTES = 128 << 20
"""Memory that the copies of a model with meshes may take; it bounds the chunk, and is kept for the
next rollout of the same scene."""


class NativeEngine:
    """C MuJoCo on the CPU; nothing to compile, bit-identical at any number of threads.

    With early stop, islands of objects that have come to rest sleep (`mjENBL_SLEEP`) until
    something touches them, so that a candidate costs what still moves in it. 3 verdicts of 1 344
    differed from full rollouts over fourteen scenes of `bench`, as chaos lets near ones differ.
    """

    name = "native"

    def __init__(self, threads: int = 0):
        """Use `threads` threads; 0 takes all cores."""
        self.threads = threads

    def rollout(
        self,
        scene: SceneModel,
        poses: Poses,
        *,
        duration: float = 1.0,
        record_every: float = 0.1,
        early_stop: EarlyStop | None = None,
    ) -> Rollout:
        """Simulate every candidate; see `Engine.rollout`. Poses in double precision stay so."""
        records, every = record_steps(scene.static.mjm.opt.timestep, duration, record_every)
        poses = jax.tree.map(np.asarray, poses)
        sleeps = early_stop is not None
        # Taken out while in use, so that a rollout in another thread makes copies of its own.
        ring = _rings.pop(scene.static, [])

        def run(some: Poses) -> Rollout:
            failed = np.zeros(len(some.scale), bool)
            recorder = Recorder(scene.static, some, records, every, early_stop, failed)
            if scene.static.mjm.nv:
                batch = open_batch(scene, some, self.threads, ring, sleeps=sleeps)
                _simulate(batch, recorder, records)
            return recorder.rollout()

        size = min(_chunk(scene), SLEEPING_CHUNK if sleeps else NATIVE_CHUNK)
        rollout = in_chunks(scene.static, poses, size, records, every, run)
        _rings[scene.static] = ring
        return rollout


_rings: "weakref.WeakKeyDictionary[StaticScene, list[mujoco.MjModel]]" = weakref.WeakKeyDictionary()
"""Model copies of scenes with convex pieces; writing one anew takes a quarter of copying it."""


def _chunk(scene: SceneModel) -> int:
    if not has_meshes(scene):
        return NATIVE_CHUNK
    return min(NATIVE_CHUNK, max(32, RING_BYTES // int(mujoco.mj_sizeModel(scene.static.mjm))))


def has_meshes(scene: SceneModel) -> bool:
    """Whether any collider is a convex piece given by its corners."""
    return bool(np.any(scene.static.mjm.geom_type == MESH))


def open_batch(
    scene: SceneModel,
    poses: Poses,
    threads: int = 0,
    ring: list[mujoco.MjModel] | None = None,
    *,
    sleeps: bool = False,
) -> Batch:
    """Build a batch whose simulation k runs candidate k's model, in its start state.

    Args:
        scene: the compiled scene.
        poses: where the candidates' objects are placed, NumPy arrays.
        threads: 0 takes all cores.
        ring: copies of the scene's model to write over, when it has meshes; extended as needed. A
            batch made from the same ring before is void.
        sleeps: whether islands at rest sleep.
    """
    wide = jax.tree.map(lambda leaf: np.asarray(leaf, float), poses)
    fields = model_fields(scene, wide, np)
    qpos = fields.pop("qpos")
    base = copy.copy(scene.static.mjm) if sleeps else scene.static.mjm
    if sleeps:
        base.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    batch = Batch(base, nsim=len(qpos), nthread=threads, persistent=sleeps)
    if has_meshes(scene):
        models = model_ring(scene, fields, wide.scale, ring)
        for model in models:
            model.opt.enableflags = base.opt.enableflags
        batch.set_models(models)
    else:
        for name, values in fields.items():
            batch.expand(name)[:] = values.reshape(batch.expand(name).shape)
        batch.set_const()
    batch.bind("qpos")[:] = qpos
    return batch


def model_ring(
    scene: SceneModel,
    fields: dict[str, np.ndarray],
    scale: AnyArray,
    ring: list[mujoco.MjModel] | None = None,
) -> list[mujoco.MjModel]:
    """Write each candidate into its own copy of the scene's model, meshes included.

    Args:
        scene: the compiled scene.
        fields: of `model_fields`.
        scale: of every object, shape [pop, object].
        ring: copies made before, to be written over; extended as needed.
    """
    base, pop = scene.static.mjm, len(scale)
    ring = [] if ring is None else ring
    ring.extend(copy.copy(base) for _ in range(pop - len(ring)))
    data = mujoco.MjData(base)
    fields = {name: v.reshape(pop, *getattr(base, name).shape) for name, v in fields.items()}
    owners = _mesh_owners(scene)
    mesh, vert, box = (owner_scale(scale, owner, np)[..., None] for owner in owners)
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
    base, mesh = scene.static.mjm, mesh_object(scene)
    box, count = np.full(base.nbvh, -1), base.mesh_bvhnum
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    box[np.repeat(base.mesh_bvhadr, count) + within] = np.repeat(mesh, count)
    return mesh, np.repeat(mesh, base.mesh_vertnum), box


def _simulate(batch: Batch, recorder: Recorder, records: int) -> None:
    """Step a batch from record to record until no candidate runs on."""
    qpos, qvel, qacc = (batch.bind(name) for name in ("qpos", "qvel", "qacc"))
    # What sleeps keeps gravity as its acceleration in MuJoCo's data.
    tree, asleep = batch.model.dof_treeid, batch.bind("tree_asleep")
    segments = recorder.segments()
    for time, steps in itertools.product(range(records), segments):
        recorder.drop(_step(batch, recorder.active, steps), RolloutStatus.FAILED)
        rows = recorder.active
        if not len(rows):
            break
        acceleration = np.where(asleep[rows][:, tree] >= 0, 0.0, qacc[rows])
        recorder.record(time, qpos[rows], qvel[rows], acceleration, steps)


def _step(batch: Batch, active: NDArray, steps: int) -> NDArray:
    """Step some simulations; return which of them failed."""
    failed = np.zeros(len(active), bool)
    if not len(active):
        return failed
    try:
        batch.step(ids=active.astype(np.int32), nstep=steps)
    except SimulationError as error:
        failed = np.isin(active, error.ids)
    return failed

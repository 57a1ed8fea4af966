"""Rollouts with C MuJoCo on all cores: `mujoco.batch.Batch` with per-candidate model fields.

For scenes of primitives, the model fields that differ between candidates are expanded. All models
of a batch share their mesh vertices, so for scenes with meshes each candidate has a copy of the
model. These copies are reused and scaled in place.
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
from .engine import BatchEngine, Rollout, RolloutStatus, Schedule
from .guidance import GuidedBodies, guided_bodies
from .layout import Poses
from .model import MESH, CompiledScene, StaticScene
from .model_fields import mesh_object, model_fields, owner_scale
from .recorder import Recorder, simulate_in_chunks

NATIVE_CHUNK = 1024
"""Largest number of candidates simulated at once."""
SLEEPING_CHUNK = 256
"""Largest number of candidates simulated at once if objects may sleep. MuJoCo then keeps data for
each candidate."""
MODEL_COPIES_BYTES = 128 << 20
"""Memory for the copies of a model with meshes, which limits the number of candidates simulated at
once. The copies are kept for the next rollout of the same scene."""


class NativeEngine(BatchEngine):
    """C MuJoCo on the CPU. Compiles nothing; results are bit-identical for any number of threads.

    With early stopping, islands of bodies at rest sleep (`mjENBL_SLEEP`) until something touches
    them, so only moving islands take time. Over fourteen benchmark scenes, 3 of 1 344 verdicts
    differed from those of full rollouts, since nearby trajectories of chaotic systems diverge.
    """

    name = "native"

    def __init__(self, threads: int = 0):
        """Use `threads` threads; 0 uses all cores."""
        self.threads = threads

    def simulate(self, scene: CompiledScene, poses: Poses, schedule: Schedule) -> Rollout:
        """Simulate every candidate, in the precision of its poses; see `Engine.rollout`."""
        poses = jax.tree.map(np.asarray, poses)
        sleeps = schedule.early_stop is not None
        # Remove the copies while in use, so that a rollout in another thread makes other copies.
        model_copies = _model_copies.pop(scene.static, [])

        def run(chunk: Poses) -> Rollout:
            recorder = Recorder(scene.static, chunk, schedule)
            if scene.static.mjm.nv:
                batch = open_batch(scene, chunk, self.threads, model_copies, sleeps=sleeps)
                _simulate(batch, recorder, schedule, guided_bodies(scene, chunk, np))
            return recorder.rollout()

        size = SLEEPING_CHUNK if sleeps else NATIVE_CHUNK
        if has_meshes(scene):
            max_copies = MODEL_COPIES_BYTES // int(mujoco.mj_sizeModel(scene.static.mjm))
            size = min(NATIVE_CHUNK, size, max(32, max_copies))
        rollout = simulate_in_chunks(scene.static, poses, size, schedule, run)
        _model_copies[scene.static] = model_copies
        return rollout


_model_copies: "weakref.WeakKeyDictionary[StaticScene, list[mujoco.MjModel]]" = (
    weakref.WeakKeyDictionary()
)
"""Model copies of scenes with meshes. Overwriting a copy takes a quarter of the time of copying."""


def has_meshes(scene: CompiledScene) -> bool:
    """Return whether any collision geom is a mesh."""
    return bool(np.any(scene.static.mjm.geom_type == MESH))


def open_batch(
    scene: CompiledScene,
    poses: Poses,
    threads: int = 0,
    model_copies: list[mujoco.MjModel] | None = None,
    *,
    sleeps: bool = False,
) -> Batch:
    """Build a batch in which simulation k runs the model of candidate k from its initial state.

    Args:
        scene: the compiled scene.
        poses: initial poses of the candidates' objects, NumPy arrays.
        threads: number of threads; 0 uses all cores.
        model_copies: copies of the scene's model, which are overwritten if the scene has meshes.
            The list is extended as needed. A batch built earlier from the same list becomes
            invalid.
        sleeps: if True, islands of bodies at rest sleep.
    """
    double_poses = jax.tree.map(lambda leaf: np.asarray(leaf, float), poses)
    fields = model_fields(scene, double_poses, np)
    qpos = fields.pop("qpos")
    base = copy.copy(scene.static.mjm) if sleeps else scene.static.mjm
    if sleeps:
        base.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    batch = Batch(base, nsim=len(qpos), nthread=threads, persistent=sleeps)
    if has_meshes(scene):
        models = _models_of_candidates(
            scene, fields, double_poses.scale, [] if model_copies is None else model_copies
        )
        for model in models:
            model.opt.enableflags = base.opt.enableflags
        batch.set_models(models)
    else:
        for name, values in fields.items():
            batch.expand(name)[:] = values.reshape(batch.expand(name).shape)
        batch.set_const()
    if sleeps:  # static bodies always sleep: a reset puts those of each candidate in their places
        batch.reset(stage=int(mujoco.mjtStage.mjSTAGE_NONE))
    batch.bind("qpos")[:] = qpos
    return batch


def _models_of_candidates(
    scene: CompiledScene,
    fields: dict[str, np.ndarray],
    scale: AnyArray,
    model_copies: list[mujoco.MjModel],
) -> list[mujoco.MjModel]:
    """Write the fields and meshes of each candidate into a separate copy of the scene's model."""
    base, pop = scene.static.mjm, len(scale)
    model_copies.extend(copy.copy(base) for _ in range(pop - len(model_copies)))
    data = mujoco.MjData(base)
    fields = {name: v.reshape(pop, *getattr(base, name).shape) for name, v in fields.items()}
    mesh, vert, box = (owner_scale(scale, owners, np)[..., None] for owners in _mesh_owners(scene))
    for k, model in enumerate(model_copies[:pop]):
        for name, values in fields.items():
            getattr(model, name)[:] = values[k]
        model.mesh_vert[:] = base.mesh_vert * vert[k]
        model.mesh_pos[:] = base.mesh_pos * mesh[k]
        model.bvh_aabb[:] = base.bvh_aabb * box[k]
        mujoco.mj_setConst(model, data)
    return model_copies[:pop]


def _mesh_owners(scene: CompiledScene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the object of each mesh, mesh vertex and bounding volume; -1 if there is none."""
    base, mesh = scene.static.mjm, mesh_object(scene)
    box, count = np.full(base.nbvh, -1), base.mesh_bvhnum
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    box[np.repeat(base.mesh_bvhadr, count) + within] = np.repeat(mesh, count)
    return mesh, np.repeat(mesh, base.mesh_vertnum), box


def _simulate(batch: Batch, recorder: Recorder, schedule: Schedule, bodies: GuidedBodies) -> None:
    """Step a batch from record to record until no candidate is active."""
    qpos, qvel, qacc = (batch.bind(name) for name in ("qpos", "qvel", "qacc"))
    applied, guidance = batch.bind("qfrc_applied"), schedule.guidance
    timestep = float(batch.model.opt.timestep)
    if guidance is not None and schedule.early_stop is None:
        batch.forward()  # warm-starts the first step, as in a simulation after mj_forward
    # MuJoCo reports gravity as the acceleration of a sleeping tree.
    tree, asleep = batch.model.dof_treeid, batch.bind("tree_asleep")
    for time, steps in itertools.product(range(schedule.records), recorder.segments()):
        if guidance is not None and len(rows := recorder.active):
            now = float(recorder.steps[rows].max()) * timestep
            applied[rows], qvel[rows] = bodies.take(rows).push(
                guidance, now, qpos[rows], qvel[rows]
            )
        recorder.drop(_step(batch, recorder.active, steps), RolloutStatus.FAILED)
        rows = recorder.active
        if not len(rows):
            break
        acceleration = np.where(asleep[rows][:, tree] >= 0, 0.0, qacc[rows])
        recorder.record(time, qpos[rows], qvel[rows], acceleration, steps)


def _step(batch: Batch, active: NDArray, steps: int) -> NDArray:
    """Step the active simulations; return a mask of those that failed."""
    if not len(active):
        return np.zeros(0, bool)
    try:
        batch.step(ids=active.astype(np.int32), nstep=steps)
    except SimulationError as error:
        return np.isin(active, error.ids)
    return np.zeros(len(active), bool)

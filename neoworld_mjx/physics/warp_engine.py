"""Rollouts on NVIDIA GPUs with MuJoCo Warp; each candidate is one world.

The batched fields of the model have separate values for each candidate. Mesh vertices are not
batched, so the vertices of all candidates are concatenated, and the `geom_dataid` of each world
refers to the vertices of that world. Scales are therefore exact.
"""

import ctypes
import functools
import importlib.util
import sys
import weakref
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..errors import EngineError
from .derived import invweights, static_geoms, subtree_mass
from .engine import BatchEngine, Rollout, RolloutStatus, Schedule, unplaceable
from .guidance import Guidance, GuidedBodies, guided_bodies
from .layout import Poses
from .model import CompiledScene, StaticScene
from .model_fields import mesh_object, model_fields, owner_scale
from .native import NativeEngine
from .recorder import SIMULATED_FIELDS, Recorder, simulate_in_chunks

if TYPE_CHECKING:
    from .warp_worlds import Worlds

WARP_CHUNK = 8192
"""Largest number of candidates simulated at once."""

MAX_POOL_DOUBLINGS = 3
"""Number of times that an overflowing contact pool is doubled before `native` takes over."""

BUCKETS = 8
"""Number of parts of a power of two. Worlds are launched in whole parts, so that few graphs are
captured."""

FILLER = np.iinfo(int).max
"""Index of a world that only fills the launched number of worlds."""

_NOT_FIELDS = ("qpos", "site_pos")


class Counts(NamedTuple):
    """Counters of all rollouts of an engine so far."""

    candidates: int = 0
    truncated: int = 0
    """Candidates that exceeded the capacity and were rolled out again by `native`."""
    pool_doublings: int = 0
    """Populations that were rolled out again with a larger contact pool."""


class WarpEngine(BatchEngine):
    """MuJoCo Warp on an NVIDIA GPU. The first rollout of a scene compiles and captures graphs."""

    name = "warp"

    def __init__(self) -> None:
        """Use the current NVIDIA GPU.

        Raises:
            EngineError: warp is not installed, or there is no NVIDIA GPU.
        """
        self.device = warp_device()
        self.counts = Counts()
        self._worlds: "weakref.WeakKeyDictionary[StaticScene, Worlds]" = weakref.WeakKeyDictionary()

    def simulate(self, scene: CompiledScene, poses: Poses, schedule: Schedule) -> Rollout:
        """Simulate every candidate; see `Engine.rollout`.

        Results vary in the last bits between runs, since the order of sums on a GPU varies.

        Raises:
            EngineError: MuJoCo Warp cannot simulate the scene, or the GPU's memory is too small.
        """
        poses = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), poses)
        size = self._chunk_size(scene, poses)
        run = functools.partial(self._simulate_chunk, scene, schedule=schedule)
        rollout = simulate_in_chunks(scene.static, poses, size, schedule, run)
        truncated = np.flatnonzero(rollout.status == int(RolloutStatus.TRUNCATED))
        c, pop = self.counts, len(rollout.status)
        self.counts = c._replace(
            candidates=c.candidates + pop, truncated=c.truncated + len(truncated)
        )
        if len(truncated):
            native_rollout = NativeEngine().simulate(scene, poses[truncated], schedule)
            for name in SIMULATED_FIELDS:
                getattr(rollout, name)[truncated] = getattr(native_rollout, name)
        return rollout

    def worlds(self, scene: CompiledScene, pop: int, poses: Poses) -> "Worlds":
        """Return worlds with memory and captured steps for at least `pop` candidates of a scene."""
        from .warp_worlds import Worlds, probe

        worlds = self._worlds.get(scene.static)
        if worlds is None or worlds.capacity.worlds < pop:
            capacity = worlds.capacity if worlds else probe(scene, poses)
            # Kernels are compiled for the batch sizes of the model's fields.
            capacity = capacity._replace(worlds=max(64, 1 << (pop - 1).bit_length()))
            try:
                self._worlds[scene.static] = worlds = Worlds(scene.static, capacity, self.device)
            except RuntimeError as error:
                if "allocate" not in str(error):
                    raise
                raise EngineError(
                    f"warp: {capacity.worlds} worlds do not fit into the GPU's memory ({error}); "
                    "if JAX has allocated it, import neoworld_mjx before JAX starts, or set "
                    "XLA_PYTHON_CLIENT_PREALLOCATE=false"
                ) from None
        return worlds

    def _chunk_size(self, scene: CompiledScene, poses: Poses) -> int:
        placeable = poses[~unplaceable(poses)]
        if scene.static.mjm.nv == 0 or not len(placeable.scale):
            return WARP_CHUNK
        return min(WARP_CHUNK, self.worlds(scene, 1, placeable).fitting_worlds())

    def _simulate_chunk(self, scene: CompiledScene, poses: Poses, *, schedule: Schedule) -> Rollout:
        """Roll out candidates at once; candidates whose contacts do not fit become TRUNCATED."""
        pop = len(poses.scale)
        if scene.static.mjm.nv == 0:
            return Recorder(scene.static, poses, schedule).rollout()
        # Powers of two, so that few shapes are compiled and captured.
        padded = 1 << (pop - 1).bit_length()
        padded_poses = poses[np.resize(np.arange(pop), padded)]
        fields, start = _prepare(scene, padded_poses)
        for attempt in range(MAX_POOL_DOUBLINGS + 1):
            worlds = self.worlds(scene, padded, poses)
            recorder = Recorder(scene.static, poses, schedule)
            bodies = guided_bodies(scene, padded_poses, np) if schedule.guidance else None
            truncated, pool_full = _advance(
                worlds, fields, np.asarray(start), recorder, schedule, bodies
            )
            if not pool_full:
                break
            if attempt == MAX_POOL_DOUBLINGS:
                truncated[:] = True
                break
            self._worlds[scene.static] = worlds.with_doubled_pool()
            self.counts = self.counts._replace(pool_doublings=self.counts.pool_doublings + 1)
        recorder.status[truncated] = int(RolloutStatus.TRUNCATED)
        return recorder.rollout()


def _advance(
    worlds: "Worlds",
    fields: dict[str, Any],
    start: np.ndarray,
    recorder: Recorder,
    schedule: Schedule,
    bodies: GuidedBodies | None = None,
) -> tuple[np.ndarray, bool]:
    """Simulate until all candidates have stopped or the time is over.

    Returns:
        A mask [pop] of candidates that ran out of constraints; and True if a pool that all worlds
        share was full, which invalidates all candidates.
    """
    pop = len(recorder.status)
    truncated = np.zeros(pop, bool)
    bucket = max(1, len(start) // BUCKETS)
    launched = -(-pop // bucket) * bucket
    worlds.load(fields, start[:launched])
    rows = np.concatenate([np.arange(pop), np.full(launched - pop, FILLER)])
    for time in range(schedule.records):
        if bodies is None or schedule.guidance is None:
            worlds.step(schedule.every)
        else:
            world_bodies = bodies.take(np.where(rows == FILLER, recorder.active[0], rows))
            _guided_steps(worlds, world_bodies, schedule.guidance, recorder, time)
        qpos, qvel, qacc, overflow = worlds.read(moving=schedule.early_stop is not None)
        if (overflow & worlds.SHARED).any():
            return truncated, True
        active = np.searchsorted(rows, recorder.active)
        if len(active) < len(rows):
            qpos, qvel, qacc, overflow = (
                None if x is None else x[active] for x in (qpos, qvel, qacc, overflow)
            )
        out_of_constraints = (overflow & worlds.PER_WORLD) != 0
        truncated[recorder.active[out_of_constraints]] = True
        before = np.count_nonzero(recorder.status == RolloutStatus.FAILED)
        running = recorder.record(time, qpos, qvel, qacc) & ~out_of_constraints
        failed = np.count_nonzero(recorder.status == RolloutStatus.FAILED) > before
        recorder.active = recorder.active[~truncated[recorder.active]]
        remaining = len(recorder.active)
        if remaining == 0 or time + 1 == schedule.records:
            break
        launched = -(-remaining // bucket) * bucket
        if launched < len(rows) or failed:
            if qvel is None or qacc is None:
                _, qvel, qacc, _ = (x[active] for x in worlds.read())
            # Active candidates move to the front. Copies of the first one fill the rest.
            fill = np.zeros(max(min(launched, len(rows)) - remaining, 0), int)
            keep = np.flatnonzero(running)
            keep = np.concatenate([keep, keep[fill]])
            worlds.compact(active[keep], qpos[keep], qvel[keep], qacc[keep], scrub=failed)
            rows = np.concatenate([recorder.active, np.full(len(fill), FILLER)])
    return truncated, False


def _guided_steps(
    worlds: "Worlds", bodies: GuidedBodies, guidance: Guidance, recorder: Recorder, record: int
) -> None:
    """Step the worlds to the next record, and update the springs' forces on the way."""
    timestep = float(worlds.static.mjm.opt.timestep)
    steps_done = record * recorder.every
    for steps in recorder.segments():
        qpos, qvel, _, _ = worlds.read()
        assert qvel is not None
        worlds.push(*bodies.push(guidance, steps_done * timestep, qpos, qvel))
        worlds.step(steps)
        steps_done += steps


@eqx.filter_jit
def _prepare(scene: CompiledScene, poses: Poses) -> tuple[dict[str, Any], Any]:
    """Return the candidates' model fields, flattened to [pop, n], and their initial states."""
    static = scene.static
    all_fields = model_fields(scene, poses) | invweights(scene, poses)
    start = all_fields["qpos"]
    fields = {name: value for name, value in all_fields.items() if name not in _NOT_FIELDS}
    fields["body_subtreemass"] = subtree_mass(static, fields["body_mass"])
    # A population without variations may follow one with them.
    friction = jnp.broadcast_to(static.mjm.geom_friction, (len(start), static.mjm.ngeom, 3))
    fields.setdefault("geom_friction", friction)
    xpos, xmat = static_geoms(static, fields["body_pos"], fields["body_quat"], fields["geom_pos"])
    fields |= {"geom_xpos": xpos, "geom_xmat": xmat}
    if static.mjm.nmesh:
        owner = np.repeat(mesh_object(scene), static.mjm.mesh_vertnum)
        fields["mesh_vert"] = static.mjm.mesh_vert * owner_scale(poses.scale, owner)[..., None]
    flat = {
        name: jnp.asarray(value, jnp.float32).reshape(len(value), -1)
        for name, value in fields.items()
    }
    return flat, start


def warp_device() -> Any:
    """Return warp's device for the current NVIDIA GPU.

    Raises:
        EngineError: warp or MuJoCo Warp is not installed, or there is no NVIDIA GPU.
    """
    missing = [name for name in ("warp", "mujoco_warp") if importlib.util.find_spec(name) is None]
    if missing:
        raise EngineError(
            f"engine warp needs its extra ({missing[0]} is missing): "
            "uv sync --inexact --extra warp, or use --engine native"
        )
    if not _driver():
        raise EngineError(
            "engine warp needs an NVIDIA GPU and its driver, and found none: use --engine native, "
            "or mjx on another accelerator"
        )
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    wp.init()
    return wp.get_preferred_device()


def _driver() -> bool:
    """Return whether NVIDIA's driver finds a GPU. This is much faster than initializing warp."""
    try:
        cuda = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return False
    count = ctypes.c_int(0)
    return (
        cuda.cuInit(0) == 0 and cuda.cuDeviceGetCount(ctypes.byref(count)) == 0 and count.value > 0
    )

"""Rollouts in JAX: `mjx_step`, vmapped over per-candidate model fields.

MJX has no mj_setConst, so `derived` computes the fields that MuJoCo derives from masses. Several
devices share the candidates and compute independently.
"""

import functools
import weakref
from collections.abc import Callable, Sequence
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Bool, Float

from .engine import BatchEngine, Rollout, RolloutStatus, Schedule
from .guidance import Guidance, GuidedBodies, guided_bodies
from .layout import Poses
from .mjx_model import (
    Fields,
    MjxData,
    MjxModel,
    candidate_fields,
    make_data,
    mjx_step,
    pairs_dropped,
    put_model,
    with_fields,
)
from .model import CompiledScene, StaticScene
from .recorder import Recorder, simulate_in_chunks
from .sharding import REPLICATED, SHARDED, device_mesh, map_shards, put

MJX_CHUNK = 8192
"""Largest number of candidates that a device simulates at once."""

MEMORY_SHARE, CPU_MEMORY = 0.4, 1 << 30
"""Largest memory of a chunk: a fraction of an accelerator's memory, and a number of bytes on a CPU.
"""

GUIDED_AXES = GuidedBodies(bodies=cast(Any, None), springs=cast(Any, 0))
"""The `in_axes` of `Held` for `vmap`. Only the springs differ between candidates."""
GUIDED_SPECS = GuidedBodies(bodies=cast(Any, REPLICATED), springs=cast(Any, SHARDED))
"""Partition specifications of `Held` for several devices."""

COMPACT_FROM = 512
"""Least population whose running candidates move to smaller arrays as other candidates stop. Each
size of arrays is compiled once. For smaller populations, computing stopped candidates costs less
than another compilation."""


class MjxEngine(BatchEngine):
    """MJX on one or several JAX devices of one kind. The first rollout of a scene compiles."""

    name = "mjx"

    def __init__(self, devices: Sequence[Any] | None = None):
        """Split populations over `devices`; if None, over all devices of JAX's default backend."""
        self.devices = tuple(jax.devices() if devices is None else devices)
        self.mesh = device_mesh(self.devices)
        self._scenes: weakref.WeakKeyDictionary[StaticScene, tuple[MjxModel, CompiledScene]] = (
            weakref.WeakKeyDictionary()
        )

    def simulate(self, scene: CompiledScene, poses: Poses, schedule: Schedule) -> Rollout:
        """Simulate every candidate; see `Engine.rollout`."""
        model, scene = self.on_devices(scene)
        poses = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), poses)
        # Powers of two, so that populations share compilations.
        size = self.chunk(model, 1 << (poses.scale.shape[0] - 1).bit_length())

        def run(chunk: Poses) -> Rollout:
            count = len(chunk.scale)
            if scene.static.mjm.nv == 0:
                return Recorder(scene.static, chunk, schedule).rollout()
            # All chunks are padded to one shape, which is compiled once.
            padded = self.split(chunk[np.minimum(np.arange(size), count - 1)])
            rollout = self._simulate_chunk(model, scene, padded, schedule)
            rows = jax.tree.map(lambda leaf: np.asarray(leaf)[:count], rollout)
            return eqx.tree_at(lambda r: r.time, rows, np.asarray(rollout.time))

        return simulate_in_chunks(scene.static, poses, size, schedule, run)

    def _simulate_chunk(
        self, model: MjxModel, scene: CompiledScene, poses: Poses, schedule: Schedule
    ) -> Rollout:
        """Simulate record by record; drop stopped candidates once the rest fits a smaller size."""
        fields, start = _prepare(scene, poses)
        data = _initial_data(model, fields, start, self.mesh)
        springs = _guided_bodies(scene, poses) if schedule.guidance else None
        recorder = Recorder(scene.static, poses, schedule)
        rows = np.arange(len(recorder.status))
        sizes = [len(rows) // k for k in (8, 4, 2)] if len(rows) >= COMPACT_FROM else []
        truncated = np.zeros(len(rows), bool)
        for time in range(schedule.records):
            if not len(recorder.active):
                break
            data, dropped = _advance(
                model, fields, data, schedule.every, schedule.guidance, springs, self.mesh
            )
            if self.mesh is not None:
                # XLA returns empty arrays unsharded, which would compile the next call again.
                data = self.split(data)
            active = np.searchsorted(rows, recorder.active)
            truncated[recorder.active] |= np.asarray(dropped)[active]
            qpos, qvel, qacc = (np.asarray(x)[active] for x in (data.qpos, data.qvel, data.qacc))
            running = recorder.record(time, qpos, qvel, qacc)
            fits = [s for s in sizes if len(recorder.active) <= s < len(rows)]
            if fits and len(recorder.active):
                keep = active[running]
                fill = np.full(fits[0] - len(keep), keep[0])
                index = jnp.asarray(np.concatenate([keep, fill]))
                fields, data = self.split(_take((fields, data), index))
                if springs is not None:
                    springs = springs._replace(springs=self.split(springs.take(index).springs))
                rows = np.concatenate([recorder.active, fill * 0 + np.iinfo(int).max])
        finished = recorder.status != int(RolloutStatus.FAILED)
        recorder.status[truncated & finished] = int(RolloutStatus.TRUNCATED)
        return recorder.rollout()

    def chunk(self, model: MjxModel, pop: int) -> int:
        """Return the number of candidates that fit into the devices' memory at once."""
        shapes = jax.eval_shape(lambda m: make_data(m), model)
        # The states before and after a step, and as much again for intermediate values.
        candidate_bytes = 4 * sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(shapes))
        # All combinations of an edge and a face in every evaluated pair.
        candidate_bytes += (
            40 * model.near * model.solids.edge.shape[1] * model.solids.plane.shape[1]
        )
        device, count = self.devices[0], len(self.devices)
        stats = (device.memory_stats() or {}) if device.platform != "cpu" else {}
        budget = int(MEMORY_SHARE * stats.get("bytes_limit", CPU_MEMORY / MEMORY_SHARE)) * count
        max_candidates = max(64, 1 << (max(budget // max(candidate_bytes, 1), 1).bit_length() - 1))
        chunk = min(pop, MJX_CHUNK * count, max_candidates)
        return -(-chunk // count) * count

    def split(self, tree: Any) -> Any:
        """Split the leading axis of all arrays over the devices."""
        if self.mesh is None:
            return jax.device_put(tree, self.devices[0])
        return put(tree, self.mesh, SHARDED)

    def on_devices(self, scene: CompiledScene) -> tuple[MjxModel, CompiledScene]:
        """Return the model and the scene on the engine's devices."""
        if scene.static not in self._scenes:
            arrays, rest = eqx.partition(scene, eqx.is_array)
            tree = (put_model(scene.static.mjm, scene.static.start), arrays)
            if self.mesh is None:
                model, arrays = jax.device_put(tree, self.devices[0])
            else:
                model, arrays = put(tree, self.mesh, REPLICATED)
            self._scenes[scene.static] = model, eqx.combine(arrays, rest)
        return self._scenes[scene.static]


@eqx.filter_jit
def _prepare(scene: CompiledScene, poses: Poses) -> tuple[Fields, Float[Array, "pop nq"]]:
    """Return the model fields and initial states of candidates."""
    return candidate_fields(scene, poses)


@eqx.filter_jit
def _guided_bodies(scene: CompiledScene, poses: Poses) -> GuidedBodies:
    return guided_bodies(scene, poses)


def _candidates(
    one: Callable[..., Any], springs: GuidedBodies | None, mesh: Mesh | None
) -> Callable[..., Any]:
    """Map a function of model, fields, state and springs over candidates and devices."""
    bodies_axes, bodies_specs = (
        (None, REPLICATED) if springs is None else (GUIDED_AXES, GUIDED_SPECS)
    )
    mapped = jax.vmap(one, in_axes=(None, 0, 0, bodies_axes))
    return map_shards(mapped, mesh, REPLICATED, SHARDED, SHARDED, bodies_specs)


def _push_function(
    guidance: Guidance | None, bodies: GuidedBodies | None
) -> Callable[[MjxData], MjxData] | None:
    """Return the argument `push` of `mjx_step` that applies the springs; None without guidance."""
    if guidance is None or bodies is None:
        return None

    def push(d: MjxData) -> MjxData:
        applied, qvel = bodies.push(guidance, d.time, d.qpos, d.qvel, jnp)
        return d.replace(qfrc_applied=applied, qvel=qvel)

    return push


@functools.partial(jax.jit, static_argnames=("mesh",))
def _initial_data(
    model: MjxModel, fields: Fields, qpos: Float[Array, "pop nq"], mesh: Mesh | None
) -> MjxData:
    make = lambda m, values, start, _: make_data(with_fields(m, values)).replace(qpos=start)
    return _candidates(make, None, mesh)(model, fields, qpos, None)


@functools.partial(
    jax.jit, static_argnames=("every", "guidance", "mesh"), donate_argnames=("data",)
)
def _advance(
    model: MjxModel,
    fields: Fields,
    data: MjxData,
    every: int,
    guidance: Guidance | None,
    springs: GuidedBodies | None,
    mesh: Mesh | None,
) -> tuple[MjxData, Bool[Array, " pop"]]:
    def one(
        model: MjxModel, values: Fields, d: MjxData, bodies: GuidedBodies | None
    ) -> tuple[MjxData, Array]:
        m = with_fields(model, values)
        d = mjx_step(m, d, every, _push_function(guidance, bodies))
        return d, pairs_dropped(m, d)

    return _candidates(one, springs, mesh)(model, fields, data, springs)


@jax.jit
def _take(tree: Any, index: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)

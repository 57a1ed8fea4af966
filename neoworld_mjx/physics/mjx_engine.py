"""Rollouts in JAX: MJX's own implementation, vmapped over per-candidate model fields.

MJX has no mj_setConst, so fields that MuJoCo derives from masses come from `derived`. Convex pieces
are scaled in the model's vertex arrays (`ConvexMesh.vert` and `.face` both hold coordinates).
"""

import contextlib
import functools
import io
import weakref
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float

from ..errors import EngineError
from .derived import invweights
from .engine import EarlyStop, Rollout, RolloutStatus, record_steps, unplaceable
from .layout import Poses
from .lowering import lowered
from .model import SceneModel, StaticScene
from .model_fields import mesh_object, model_fields, owner_scale
from .recorder import DIVERGED, Recorder, joined, read_states, record_times

# MJX prints that warp is missing, which is an extra here and no failure.
with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx

CHUNK = 8192
"""Most candidates simulated at once."""

MEMORY_SHARE, CPU_MEMORY = 0.4, 1 << 30
"""Of an accelerator's memory, and bytes on a CPU, that one chunk may take."""

COMPACTED = 512
"""From this many candidates on a shrinking population moves into smaller programs, each of which
compiles once; below it a program that runs half empty costs less than another compilation."""

_MODEL_FIELDS = (
    *("body_pos", "body_quat", "body_ipos", "body_mass", "body_inertia", "geom_pos", "geom_size"),
    *("geom_rbound", "geom_aabb", "jnt_pos", "jnt_range", "jnt_stiffness", "jnt_actfrcrange"),
    *("dof_armature", "dof_damping", "dof_frictionloss", "qpos0", "qpos_spring", "eq_data"),
    *("body_invweight0", "dof_invweight0"),
)

Fields = dict[str, Any]
"""Per-candidate values of model fields, leading axis [pop]; "vert" and "face" list the meshes'."""


class MjxEngine:
    """MJX on any JAX device, or several of one kind. The first rollout of a scene compiles.

    Colliders that MJX cannot collide are replaced by polyhedra; see `lowering`.
    """

    name = "mjx"

    def __init__(self, devices: Sequence[Any] | None = None):
        """Split populations over `devices`; None takes all of JAX's default kind."""
        self.devices = tuple(jax.devices() if devices is None else devices)
        self._scenes: weakref.WeakKeyDictionary[StaticScene, tuple[mjx.Model, SceneModel]] = (
            weakref.WeakKeyDictionary()
        )

    def rollout(
        self,
        scene: SceneModel,
        poses: Poses,
        *,
        duration: float = 1.0,
        record_every: float = 0.1,
        early_stop: EarlyStop | None = None,
    ) -> Rollout:
        """Simulate every candidate; see `Engine.rollout`.

        Raises:
            EngineError: the scene has something that MJX cannot simulate.
        """
        records, every = record_steps(scene.static.mjm.opt.timestep, duration, record_every)
        model, scene = self._carried(scene)
        pop = poses.scale.shape[0]
        size = self._chunk(model, pop)
        run = self._whole if early_stop is None else self._segments
        parts = []
        for first in range(0, pop, size):
            # The last chunk is filled up, so that all have one shape and one compilation.
            index = np.minimum(np.arange(first, first + size), pop - 1)
            chunk = jax.tree.map(lambda x, i=index: jnp.asarray(x, jnp.float32)[i], poses)
            if scene.static.mjm.nv == 0:
                bad = unplaceable(jax.tree.map(np.asarray, chunk))
                recorder = Recorder(scene.static, chunk, records, every, early_stop, bad)
                parts.append(recorder.rollout())
                continue
            parts.append(run(model, scene, self._spread(chunk), records, every, early_stop))
        return joined(parts, pop)

    def _whole(
        self,
        model: mjx.Model,
        scene: SceneModel,
        poses: Poses,
        records: int,
        every: int,
        rule: EarlyStop | None,
    ) -> Rollout:
        """Run to the end in one program."""
        fields, start, bad = _prepare(model, scene, poses)
        qpos = bare_scan(model, fields, start, records, every)
        return _rollout(scene, poses, qpos, bad, records, every)

    def _segments(
        self,
        model: mjx.Model,
        scene: SceneModel,
        poses: Poses,
        records: int,
        every: int,
        rule: EarlyStop | None,
    ) -> Rollout:
        """Run record by record; candidates that have stopped leave once a smaller program fits."""
        fields, start, bad = _prepare(model, scene, poses)
        data = _begin(model, fields, start)
        recorder = Recorder(scene.static, poses, records, every, rule, np.asarray(bad))
        rows = np.arange(len(recorder.status))
        sizes = [len(rows) // k for k in (8, 4, 2)] if len(rows) >= COMPACTED else []
        for time in range(records):
            if not len(recorder.active):
                break
            data = _advance(model, fields, data, every)
            active = np.searchsorted(rows, recorder.active)
            state = (np.asarray(x)[active] for x in (data.qpos, data.qvel, data.qacc))
            running = recorder.record(time, *state)
            fits = [s for s in sizes if len(recorder.active) <= s < len(rows)]
            if fits and len(recorder.active):
                keep = active[running]
                fill = np.full(fits[0] - len(keep), keep[0])
                index = jnp.asarray(np.concatenate([keep, fill]))
                fields, data = self._spread(_take((fields, data), index))
                rows = np.concatenate([recorder.active, fill * 0 + np.iinfo(int).max])
        return recorder.rollout()

    def _chunk(self, model: mjx.Model, pop: int) -> int:
        shapes = jax.eval_shape(lambda m: mjx.make_data(m), model)
        # The state before and after a step, and about as much again for what lies between.
        each = 4 * sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(shapes))
        device, count = self.devices[0], len(self.devices)
        stats = (device.memory_stats() or {}) if device.platform != "cpu" else {}
        budget = int(MEMORY_SHARE * stats.get("bytes_limit", CPU_MEMORY / MEMORY_SHARE)) * count
        fit = max(64, 1 << (max(budget // max(each, 1), 1).bit_length() - 1))
        chunk = min(pop, CHUNK, fit)
        return -(-chunk // count) * count

    def _spread(self, tree: Any, axis: str | None = "pop") -> Any:
        """Split the leading axis of all leaves over the devices, or copy them to each."""
        if len(self.devices) == 1:
            return jax.device_put(tree, self.devices[0])
        mesh = Mesh(np.array(self.devices), ("pop",))
        spec = PartitionSpec() if axis is None else PartitionSpec(axis)
        return jax.device_put(tree, NamedSharding(mesh, spec))

    def _carried(self, scene: SceneModel) -> tuple[mjx.Model, SceneModel]:
        """Return MJX's model and the scene whose colliders it holds, on the engine's devices."""
        if scene.static not in self._scenes:
            model, carried = _on_device(scene)
            arrays, rest = eqx.partition(carried, eqx.is_array)
            model, arrays = self._spread((model, arrays), None)
            self._scenes[scene.static] = model, eqx.combine(arrays, rest)
        return self._scenes[scene.static]


_models: "weakref.WeakKeyDictionary[StaticScene, tuple[mjx.Model, SceneModel]]" = (
    weakref.WeakKeyDictionary()
)


def _on_device(scene: SceneModel) -> tuple[mjx.Model, SceneModel]:
    """Return MJX's model and the scene whose colliders it holds."""
    if scene.static not in _models:
        try:
            try:
                _models[scene.static] = mjx.put_model(scene.static.mjm, impl="jax"), scene
            except NotImplementedError:
                scene_ = lowered(scene)
                _models[scene.static] = mjx.put_model(scene_.static.mjm, impl="jax"), scene_
        except NotImplementedError as error:
            raise EngineError(
                f"engine mjx cannot carry this scene: {error}; take --engine native"
            ) from None
    return _models[scene.static]


@eqx.filter_jit
def _prepare(
    model: mjx.Model, scene: SceneModel, poses: Poses
) -> tuple[Fields, Float[Array, "pop nq"], Bool[Array, " pop"]]:
    """Return the candidates' model fields, their start states, and which cannot be placed."""
    every = model_fields(scene, poses) | invweights(scene, poses)
    fields: Fields = {name: every[name] for name in _MODEL_FIELDS if name in every}
    owner = mesh_object(scene)
    if np.any(owner >= 0):
        meshes = model._impl.mesh_convex  # pyright: ignore[reportAttributeAccessIssue]
        size = owner_scale(poses.scale, owner)[..., None, None]
        fields["vert"] = [c.vert * size[:, k] for k, c in enumerate(meshes)]
        fields["face"] = [c.face * size[:, k, :, :, None] for k, c in enumerate(meshes)]
    return fields, every["qpos"], unplaceable(poses, jnp)


def _with_fields(model: mjx.Model, fields: Fields) -> mjx.Model:
    """Put one candidate's fields into the model."""
    flat = {name: v for name, v in fields.items() if name not in ("vert", "face")}
    model = model.replace(**flat)
    if "vert" not in fields:
        return model
    meshes = tuple(
        c.replace(vert=vert, face=face)
        for c, vert, face in zip(
            model._impl.mesh_convex,  # pyright: ignore[reportAttributeAccessIssue]
            fields["vert"],
            fields["face"],
            strict=True,
        )
    )
    return model.replace(_impl=model._impl.replace(mesh_convex=meshes))  # pyright: ignore[reportAttributeAccessIssue]


def _steps(m: mjx.Model, data: mjx.Data, every: int) -> mjx.Data:
    # Ampere and later GPUs multiply single-precision matrices in TF32 unless told not to.
    with jax.default_matmul_precision("highest"):
        return jax.lax.fori_loop(0, every, lambda _, d: mjx.step(m, d), data)


@functools.partial(jax.jit, static_argnames=("records", "every"))
def bare_scan(
    model: mjx.Model, fields: Fields, qpos: Float[Array, "pop nq"], records: int, every: int
) -> Float[Array, "pop time nq"]:
    """Scan `mjx.step`, vmapped over all candidates, and nothing else.

    Args:
        model: the scene's model.
        fields: per-candidate values of its fields.
        qpos: start states.
        records: how many states are returned.
        every: steps between them.
    """

    def one(own: Fields, start: Float[Array, " nq"]) -> Float[Array, "time nq"]:
        m = _with_fields(model, own)

        def record(d: mjx.Data, _: None) -> tuple[mjx.Data, Array]:
            d = _steps(m, d, every)
            return d, d.qpos

        return jax.lax.scan(record, mjx.make_data(m).replace(qpos=start), None, length=records)[1]

    return jax.vmap(one)(fields, qpos)


@jax.jit
def _begin(model: mjx.Model, fields: Fields, qpos: Float[Array, "pop nq"]) -> mjx.Data:
    make = lambda own, start: mjx.make_data(_with_fields(model, own)).replace(qpos=start)
    return jax.vmap(make)(fields, qpos)


@functools.partial(jax.jit, static_argnames=("every",), donate_argnames=("data",))
def _advance(model: mjx.Model, fields: Fields, data: mjx.Data, every: int) -> mjx.Data:
    return jax.vmap(lambda own, d: _steps(_with_fields(model, own), d, every))(fields, data)


@jax.jit
def _take(tree: Any, index: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


@eqx.filter_jit
def _rollout(
    scene: SceneModel,
    poses: Poses,
    qpos: Float[Array, "pop time nq"],
    bad: Bool[Array, " pop"],
    records: int,
    every: int,
) -> Rollout:
    pop = qpos.shape[0]
    pos, quat, joint_shift = read_states(scene.static, poses, qpos, jnp)
    failed = bad | ~jnp.all(jnp.abs(qpos) < DIVERGED, axis=(1, 2))
    status = jnp.where(failed, int(RolloutStatus.FAILED), int(RolloutStatus.OK))
    return Rollout(
        time=record_times(scene.static, records, every),
        pos=pos,
        quat=quat,
        joint_shift=joint_shift,
        status=status.astype(jnp.int32),
        start=poses,
        steps=jnp.full(pop, records * every, jnp.int32),
    )

"""Rollouts in JAX: MJX's own implementation, vmapped over per-candidate model fields.

MJX has no mj_setConst, so what MuJoCo derives from masses follows its own power law here; convex
pieces are scaled in the model's vertex arrays (`ConvexMesh.vert` and `.face` both hold coordinates).
"""

import functools
import weakref
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco import mjx

from ..errors import EngineError
from .engine import EarlyStop, Rollout, RolloutStatus, record_steps
from .layout import Layout, Poses
from .model import FREE, SLIDE, Host, SceneModel, leaves, mesh_object
from .native import exact_poses, open_batch

CHUNK = 2048
"""Candidates simulated at once; bounds the memory of a large population."""

_MODEL_FIELDS = (
    *("body_pos", "body_quat", "body_ipos", "body_mass", "body_inertia", "geom_pos", "geom_size"),
    *("geom_rbound", "geom_aabb", "jnt_pos", "jnt_range", "jnt_stiffness", "jnt_actfrcrange"),
    *("dof_armature", "dof_damping", "dof_frictionloss", "qpos0", "qpos_spring", "eq_data"),
)


class MjxEngine:
    """MJX on any JAX device. The first rollout of a scene compiles."""

    name = "mjx"

    def rollout(
        self,
        scene: SceneModel,
        layouts: Layout,
        *,
        duration: float = 1.0,
        record_every: float = 0.1,
        early_stop: EarlyStop | None = None,
    ) -> Rollout:
        """Simulate every candidate; see `Engine.rollout`.

        Candidates run to the end whatever `early_stop` says: under `vmap` a stopped one costs as
        much as a running one.

        Raises:
            EngineError: the scene has colliders that MJX cannot collide.
        """
        model = _on_device(scene.host)
        timestep = scene.host.mjm.opt.timestep
        records, every = record_steps(timestep, duration, record_every)
        poses = scene.place(layouts)
        derived = invweights(scene, layouts, poses)
        pop = layouts.yaw.shape[0]
        chunk = min(CHUNK, pop)
        qpos = []
        for first in range(0, pop, chunk):
            # The last chunk is filled up, so that all have one shape and one compilation.
            index = jnp.minimum(jnp.arange(first, first + chunk), pop - 1)
            few, at, more = jax.tree.map(lambda leaf, i=index: leaf[i], (layouts, poses, derived))
            qpos.append(_simulate(model, scene, few, at, more, records, every)[: pop - first])
        found = jnp.concatenate(qpos)
        pos, quat = object_poses(scene, poses, found)
        failed = ~jnp.all(jnp.isfinite(found), axis=(1, 2))
        status = jnp.where(failed, int(RolloutStatus.FAILED), int(RolloutStatus.OK))
        return Rollout(
            time=jnp.arange(1, records + 1) * every * timestep,
            pos=pos,
            quat=quat,
            status=status.astype(jnp.int32),
            start=poses,
            steps=jnp.full(pop, records * every, jnp.int32),
        )


_models: "weakref.WeakKeyDictionary[Host, mjx.Model]" = weakref.WeakKeyDictionary()


def _on_device(host: Host) -> mjx.Model:
    if host not in _models:
        try:
            _models[host] = mjx.put_model(host.mjm, impl="jax")
        except NotImplementedError as error:
            raise EngineError(
                f"engine mjx cannot carry this scene: {error}; take --engine native"
            ) from None
    return _models[host]


@eqx.filter_jit
def _simulate(
    model: mjx.Model,
    scene: SceneModel,
    layouts: Layout,
    poses: Poses,
    derived: dict[str, Array],
    records: int,
    every: int,
) -> Float[Array, "pop time nq"]:
    fields = leaves(scene, layouts, poses) | derived
    qpos = fields.pop("qpos")
    changed = {name: fields[name] for name in (*_MODEL_FIELDS, *derived) if name in fields}
    axes = jax.tree.map(lambda _: None, model)
    many, axes = model.replace(**changed), axes.replace(**dict.fromkeys(changed, 0))
    owner = mesh_object(scene)
    if np.any(owner >= 0):
        size = poses.scale[:, owner, None, None]
        meshes = tuple(
            c.replace(vert=c.vert * size[:, k], face=c.face * size[:, k, :, :, None])
            for k, c in enumerate(model._impl.mesh_convex)  # pyright: ignore[reportAttributeAccessIssue]
        )
        flat = tuple(
            jax.tree.map(lambda _: None, c).replace(vert=0, face=0)
            for c in model._impl.mesh_convex  # pyright: ignore[reportAttributeAccessIssue]
        )
        many = many.replace(_impl=many._impl.replace(mesh_convex=meshes))  # pyright: ignore[reportAttributeAccessIssue]
        axes = axes.replace(_impl=axes._impl.replace(mesh_convex=flat))  # pyright: ignore[reportAttributeAccessIssue]

    def one(m: mjx.Model, start: Float[Array, " nq"]) -> Float[Array, "time nq"]:
        data = mjx.make_data(m).replace(qpos=start)

        def record(d: mjx.Data, _: None) -> tuple[mjx.Data, Array]:
            d = jax.lax.fori_loop(0, every, lambda _, d: mjx.step(m, d), d)
            return d, d.qpos

        return jax.lax.scan(record, data, None, length=records)[1]

    return jax.vmap(one, in_axes=(axes, 0))(many, qpos)


def object_poses(
    scene: SceneModel, start: Poses, qpos: Float[Array, "pop time nq"]
) -> tuple[Float[Array, "pop time object 3"], Float[Array, "pop time object 4"]]:
    """Read object poses out of recorded coordinates; static objects stay where they are."""
    pop, time, _ = qpos.shape
    count = start.scale.shape[1]
    pos = jnp.broadcast_to(start.pos[:, None], (pop, time, count, 3))
    quat = jnp.broadcast_to(start.quat[:, None], (pop, time, count, 4))
    m = scene.host.mjm
    free = np.flatnonzero(m.jnt_type == FREE)
    if not len(free):
        return pos, quat
    owner, adr = scene.host.jnt_object[free], m.jnt_qposadr[free]
    pos = pos.at[:, :, owner].set(qpos[:, :, adr[:, None] + np.arange(3)])
    return pos, quat.at[:, :, owner].set(qpos[:, :, adr[:, None] + np.arange(3, 7)])


def invweights(scene: SceneModel, layouts: Layout, poses: Poses) -> dict[str, Any]:
    """Compute body_invweight0 and dof_invweight0 of every candidate, leading axis [pop].

    Inverse masses go with s^-m and inverse inertias with s^-(m + 2) as long as all parts of an
    object have the same mass exponent m; other scenes are left to MuJoCo's mj_setConst.
    """
    h, m = scene.host, scene.host.mjm
    if not _uniform(h):
        exact = exact_poses(scene, layouts)
        host = Layout(*(np.asarray(x, float) for x in (layouts.xy, layouts.yaw, layouts.log_scale)))
        batch = open_batch(scene, host, exact)
        models = [batch.get_model(k) for k in range(batch.nsim)]
        names = ("body_invweight0", "dof_invweight0")
        return {
            n: jnp.asarray(np.stack([getattr(x, n) for x in models]), jnp.float32) for n in names
        }
    padded = jnp.concatenate([poses.scale, jnp.ones_like(poses.scale[:, :1])], axis=1)
    body, dof = padded[:, h.body_object], padded[:, h.dof_object]
    mass = h.powers.body_mass
    law = np.stack([-mass, -(mass + 2)], axis=-1)
    turning = np.array([_turns(m, d) for d in range(m.nv)], bool)
    own = mass[m.dof_bodyid] if m.nv else np.zeros(0)
    return {
        "body_invweight0": m.body_invweight0 * body[..., None] ** law,
        "dof_invweight0": m.dof_invweight0 * dof ** -(own + 2 * turning),
    }


def _turns(m: mujoco.MjModel, dof: int) -> bool:
    joint = m.dof_jntid[dof]
    if m.jnt_type[joint] == FREE:
        return dof - m.jnt_dofadr[joint] >= 3
    return m.jnt_type[joint] != SLIDE


@functools.lru_cache(maxsize=64)
def _uniform(host: Host) -> bool:
    for item in range(len(host.names)):
        if len(set(host.powers.body_mass[host.body_object == item].tolist())) > 1:
            return False
    return True

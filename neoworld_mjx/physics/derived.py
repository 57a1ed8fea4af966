"""Model fields that MuJoCo derives from others (mj_setConst), for a population.

Engines that keep the model on a device have no batched mj_setConst. The fields that these engines
need depend only on the scales of objects, since a layout changes neither shapes nor joint positions
within objects.
"""

import functools
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..spec.pose import quat_mul
from .layout import Layout, Poses, compose_poses, rotation
from .model import CompiledScene, StaticScene, is_rotational
from .model_fields import owner_scale
from .native import open_batch

KNOTS, LOG_SPAN = 65, 1.0
"""Number of scales, from exp(-LOG_SPAN) to exp(LOG_SPAN), that are tabulated for a scene in which
the parts of an object have different mass exponents."""


def invweights(scene: CompiledScene, poses: Poses) -> dict[str, Any]:
    """Return body_invweight0 and dof_invweight0 of every candidate, with a leading axis [pop].

    If all parts of an object have the same mass exponent m, inverse masses scale with s^-m and
    inverse inertias with s^-(m + 2), where s is the object's scale. Otherwise, the logarithms of
    MuJoCo's values at `KNOTS` scales are interpolated by cubics, with a relative error of 1e-6.
    They are inversely proportional to factors of the masses; armatures are neglected there.
    Traceable.
    """
    s, m = scene.static, scene.static.mjm
    if poses.variation is not None:
        weights = invweights(scene, replace(poses, variation=None))
        body, dof = (
            owner_scale(poses.variation.mass, owner) for owner in (s.body_object, s.dof_object)
        )
        return {
            "body_invweight0": weights["body_invweight0"] / body[..., None],
            "dof_invweight0": weights["dof_invweight0"] / dof,
        }
    body, dof = (owner_scale(poses.scale, owner) for owner in (s.body_object, s.dof_object))
    if _has_one_mass_exponent(s):
        mass = s.powers.body_mass
        exponents = np.stack([-mass, -(mass + 2)], axis=-1)
        rotational = np.array([is_rotational(m, d) for d in range(m.nv)], bool)
        dof_mass = mass[m.dof_bodyid] if m.nv else np.zeros(0)
        return {
            "body_invweight0": m.body_invweight0 * body[..., None] ** exponents,
            "dof_invweight0": m.dof_invweight0 * dof ** -(dof_mass + 2 * rotational),
        }
    bodies, dofs = _tables(scene)
    return {
        "body_invweight0": _interpolate(bodies, jnp.log(body)[..., None]),
        "dof_invweight0": _interpolate(dofs, jnp.log(dof)),
    }


def subtree_mass(static: StaticScene, body_mass: Any) -> Any:
    """Return the sum of body masses over the subtree of each body, shape [pop, nbody]."""
    m = static.mjm
    subtree = np.eye(m.nbody)
    for b in range(m.nbody - 1, 0, -1):
        subtree[m.body_parentid[b]] += subtree[b]
    return jnp.sum(body_mass[:, None, :] * subtree, axis=-1)


def static_geoms(
    static: StaticScene, body_pos: Any, body_quat: Any, geom_pos: Any
) -> tuple[Any, Any]:
    """Return the world poses of geoms that are welded to the world, and zeros for all other geoms.

    Returns:
        Positions [pop, ngeom, 3] and rotations [pop, ngeom, 3, 3].
    """
    m = static.mjm
    pop = body_pos.shape[0]
    pos, quat = {0: body_pos[:, 0] * 0}, {0: jnp.broadcast_to(jnp.array([1.0, 0, 0, 0]), (pop, 4))}
    for b in range(1, m.nbody):
        if m.body_weldid[b] == 0:
            p = int(m.body_parentid[b])
            pos[b] = pos[p] + _rotate(quat[p], body_pos[:, b])
            quat[b] = quat_mul(quat[p], body_quat[:, b], jnp)
    xpos = jnp.zeros((pop, m.ngeom, 3))
    xmat = jnp.zeros((pop, m.ngeom, 3, 3))
    for g in range(m.ngeom):
        b = int(m.geom_bodyid[g])
        if b in pos:
            xpos = xpos.at[:, g].set(pos[b] + _rotate(quat[b], geom_pos[:, g]))
            local = jnp.broadcast_to(jnp.asarray(m.geom_quat[g], jnp.float32), (pop, 4))
            xmat = xmat.at[:, g].set(rotation(quat_mul(quat[b], local, jnp)))
    return xpos, xmat


def _rotate(quat: Any, v: Any) -> Any:
    return jnp.sum(rotation(quat) * v[:, None, :], axis=-1)


@functools.lru_cache(maxsize=64)
def _has_one_mass_exponent(static: StaticScene) -> bool:
    objects = (static.body_object == k for k in range(len(static.names)))
    return all(len(set(static.powers.body_mass[bodies].tolist())) < 2 for bodies in objects)


_log_tables: dict[StaticScene, tuple[np.ndarray, np.ndarray]] = {}


def _tables(scene: CompiledScene) -> tuple[np.ndarray, np.ndarray]:
    """Return the logs of body_invweight0 [knot, nbody, 2] and dof_invweight0 [knot, nv]."""
    if scene.static not in _log_tables:
        count = len(scene.static.names)
        log = np.broadcast_to(np.linspace(-LOG_SPAN, LOG_SPAN, KNOTS)[:, None], (KNOTS, count))
        layouts = Layout(np.zeros((KNOTS, count, 2)), np.zeros((KNOTS, count)), log)
        arrangement = scene.static.arrangement
        height = np.broadcast_to(arrangement.z, (KNOTS, count))
        poses = compose_poses(arrangement, layouts, height, np)
        batch = open_batch(scene, poses)
        models = [batch.get_model(k) for k in range(KNOTS)]
        with np.errstate(divide="ignore"):
            tables = tuple(
                np.log(np.stack([getattr(model, name) for model in models]))
                for name in ("body_invweight0", "dof_invweight0")
            )
        if len(_log_tables) >= 64:
            _log_tables.clear()
        _log_tables[scene.static] = (tables[0], tables[1])
    return _log_tables[scene.static]


def _interpolate(table: np.ndarray, log: Any) -> Any:
    """Interpolate exp(table) [knot, *item] at log scales [pop, *item], by Catmull-Rom cubics.

    Extrapolation is linear.
    """
    zero = ~np.isfinite(table[0])
    finite = np.where(zero, 0.0, table)
    slope = np.gradient(finite, axis=0)
    knot = (log + LOG_SPAN) / (2 * LOG_SPAN) * (KNOTS - 1)
    knot = jnp.broadcast_to(knot, (log.shape[0], *table.shape[1:]))
    k = jnp.clip(jnp.floor(knot), 0, KNOTS - 2).astype(int)
    u = knot - k
    pick = lambda values, i: jnp.take_along_axis(jnp.asarray(values, jnp.float32), i, axis=0)
    y0, y1, m0, m1 = pick(finite, k), pick(finite, k + 1), pick(slope, k), pick(slope, k + 1)
    t = jnp.clip(u, 0.0, 1.0)
    inside = (
        y0 * (1 + 2 * t) * (1 - t) ** 2
        + y1 * t**2 * (3 - 2 * t)
        + m0 * t * (1 - t) ** 2
        - m1 * t**2 * (1 - t)
    )
    outside = jnp.where(u < 0, m0 * u, 0.0) + jnp.where(u > 1, m1 * (u - 1), 0.0)
    return jnp.where(zero, 0.0, jnp.exp(inside + outside))

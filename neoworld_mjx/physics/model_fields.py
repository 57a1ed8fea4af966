"""Fields of a scene's MuJoCo model that depend on the layout, for a population of candidates.

The fields follow the scaling laws of `spec.scale`, so compiling a rearranged scene gives the same
fields.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..spec.scale import mimic_exponents
from .layout import Poses, Variation
from .model import FREE, HINGE, MESH, SLIDE, CompiledScene


def model_fields(scene: CompiledScene, poses: Poses, xp: Any = jnp) -> dict[str, Any]:
    """Return the MjModel fields in which candidates differ, each with a leading [pop] axis.

    MuJoCo derives further fields from these (mj_setConst, bounding volumes). Of the derived fields,
    only the bounding radii and boxes of geoms are included. "qpos" is the initial state.
    """
    s, m = scene.static, scene.static.mjm
    pop = poses.scale.shape[0]
    owners = (s.body_object, s.geom_object, s.jnt_object, s.dof_object)
    body, geom, jnt, dof = (owner_scale(poses.scale, owner, xp) for owner in owners)
    p = s.powers

    body_pos, body_quat = _broadcast(m.body_pos, pop, xp), _broadcast(m.body_quat, pop, xp)
    body_pos = _set_columns(body_pos * body[..., None], s.root, poses.pos, xp)
    body_quat = _set_columns(body_quat, s.root, poses.quat, xp)
    slide = m.jnt_type == SLIDE
    qpos = _broadcast(s.start, pop, xp)
    qpos0 = _broadcast(m.qpos0, pop, xp)
    slides = m.jnt_qposadr[slide]
    if poses.variation is not None:
        opens = np.isin(m.jnt_type[s.joints], (SLIDE, HINGE))
        at = m.jnt_qposadr[s.joints[opens]]
        qpos = _set_columns(qpos, at, qpos[:, at] + poses.variation.opening[:, opens], xp)
    qpos = _set_columns(qpos, slides, qpos[:, slides] * jnt[:, slide], xp)
    for j in np.flatnonzero(m.jnt_type == FREE):
        owner, adr = s.jnt_object[j], m.jnt_qposadr[j]
        free_qpos = xp.concatenate([poses.pos[:, owner], poses.quat[:, owner]], axis=-1)
        qpos, qpos0 = (
            _set_columns(q, np.arange(adr, adr + 7), free_qpos, xp) for q in (qpos, qpos0)
        )
    fields = {
        "body_pos": body_pos,
        "body_quat": body_quat,
        "body_ipos": m.body_ipos * body[..., None],
        "body_mass": m.body_mass * body**p.body_mass,
        "body_inertia": m.body_inertia * (body**p.body_inertia)[..., None],
        "geom_pos": m.geom_pos * geom[..., None],
        "geom_size": m.geom_size * geom[..., None],
        "geom_rbound": m.geom_rbound * geom,
        "geom_aabb": m.geom_aabb.reshape(-1, 6) * geom[..., None],
        "jnt_pos": m.jnt_pos * jnt[..., None],
        "jnt_range": m.jnt_range * (jnt**p.jnt_range)[..., None],
        "jnt_stiffness": _scale_field(m.jnt_stiffness, jnt**p.jnt_stiffness),
        "jnt_actfrcrange": m.jnt_actfrcrange * (jnt**p.jnt_actfrcrange)[..., None],
        "dof_armature": m.dof_armature * dof**p.dof_armature,
        "dof_damping": _scale_field(m.dof_damping, dof**p.dof_damping),
        "dof_frictionloss": m.dof_frictionloss * dof**p.dof_frictionloss,
        "qpos0": qpos0,
        "qpos_spring": qpos0,
        "qpos": qpos,
    }
    if poses.variation is not None:
        fields |= _varied(scene, poses.variation, fields, xp)
    if m.neq:
        fields["eq_data"] = _mimic_data(scene, jnt, xp)
    if m.nsite:
        site = owner_scale(poses.scale, s.body_object[m.site_bodyid], xp)
        fields["site_pos"] = m.site_pos * site[..., None]
    return fields


def _varied(scene: CompiledScene, v: Variation, fields: dict[str, Any], xp: Any) -> dict[str, Any]:
    """Return the fields that a variation changes, and the contacts' friction."""
    s, m = scene.static, scene.static.mjm
    mass = owner_scale(v.mass, s.body_object, xp)
    slides = np.array([1.0, 0.0, 0.0])  # the first coefficient is that of sliding
    friction = owner_scale(v.friction, s.geom_object, xp)[..., None] ** slides
    column = np.full(m.njnt, -1)
    column[s.joints] = np.arange(len(s.joints))
    of_dof = column[m.dof_jntid] if m.nv else np.zeros(0, int)
    times = lambda field, factor: field * factor.reshape(*factor.shape, *[1] * (field.ndim - 2))
    return {
        "body_mass": fields["body_mass"] * mass,
        "body_inertia": fields["body_inertia"] * mass[..., None],
        "geom_friction": m.geom_friction * friction,
        "dof_frictionloss": times(
            fields["dof_frictionloss"], owner_scale(v.joint_friction, of_dof, xp)
        ),
        "dof_damping": times(fields["dof_damping"], owner_scale(v.joint_damping, of_dof, xp)),
    }


def owner_scale(scale: Any, owner: np.ndarray, xp: Any = jnp) -> Any:
    """Return the scale of the object that owns each of n items, shape [pop, n].

    `scale` contains the scales of all objects, shape [pop, object]. The owner -1 is the world,
    whose scale is 1.
    """
    # Index -1 selects the appended column of ones.
    return xp.concatenate([scale, xp.ones((scale.shape[0], 1), scale.dtype)], axis=1)[:, owner]


def _mimic_data(scene: CompiledScene, jnt: Any, xp: Any) -> Any:
    m = scene.static.mjm
    factor = xp.ones((jnt.shape[0], *m.eq_data.shape), jnt.dtype)
    joints = {}
    for item in scene.spec.objects:
        joints |= {f"{item.name}-{joint.name}": joint for joint in item.spec.joints}
    for e in range(m.neq):
        follower, leader = m.eq_obj1id[e], m.eq_obj2id[e]
        # Without a leader, the joint is constrained to a constant, the offset.
        source = joints[m.joint(leader if leader >= 0 else follower).name]
        multiplier, offset = mimic_exponents(joints[m.joint(follower).name], source)
        size = jnt[:, follower]
        pair = xp.stack([size**offset, size**multiplier], axis=-1)
        factor = _set_columns(
            factor.reshape(jnt.shape[0], -1), e * m.eq_data.shape[1] + np.arange(2), pair, xp
        )
        factor = factor.reshape(jnt.shape[0], *m.eq_data.shape)
    return m.eq_data * factor


def _broadcast(field: np.ndarray, pop: int, xp: Any) -> Any:
    return xp.broadcast_to(xp.asarray(field), (pop, *field.shape))


def _set_columns(array: Any, index: np.ndarray, values: Any, xp: Any) -> Any:
    """Write values into columns of an array [pop, n, ...]."""
    if xp is np:
        array = array.copy()
        array[:, index] = values
        return array
    return array.at[:, index].set(values)


def _scale_field(field: np.ndarray, factor: Any) -> Any:
    """Multiply a field [n] or [n, k] by a factor [pop, n]."""
    return field * (factor if field.ndim == 1 else factor[..., None])


def mesh_object(scene: CompiledScene) -> np.ndarray:
    """Return the object that each mesh asset belongs to, shape [nmesh]."""
    m = scene.static.mjm
    owner = np.full(m.nmesh, -1)
    meshes = m.geom_type == MESH
    owner[m.geom_dataid[meshes]] = scene.static.geom_object[meshes]
    return owner

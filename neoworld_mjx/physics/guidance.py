"""Guided settling: springs hold free objects near their placed poses and fade with time.

Contacts and gravity act from the beginning. Springs and dampers are proportional to each object's
mass and inertia and critically damped. An object therefore sags by only g / rate^2, and settles on
whatever it touches close to its placed pose. Once the springs have faded, only contacts support it.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float, Int

from .array_types import AnyArray
from .layout import Poses, rotation
from .model import FREE, CompiledScene

INTERVAL_S = 0.02
"""Time between two updates of the spring forces, in engines that do not update them every step [s].
"""
LEAST_SINE = 1e-9
"""Regularization that keeps twice the sine of a rotation angle positive."""


class Guidance(NamedTuple):
    """Strength and duration of the springs, and the speed limit."""

    rate: float = 12.0
    """Natural frequency of the critically damped springs [1/s]."""
    fade_s: float = 1.4
    """Time in which the springs and dampers fade linearly to zero [s]."""
    max_speed: float = 2.0
    """Limit of the linear speed of free objects [m/s]."""

    def fade_factor(self, time: Any, xp: Any = np) -> Any:
        """Return the fraction of the spring forces that remains at a time [s]."""
        return xp.maximum(0.0, 1.0 - time / self.fade_s)


class FreeBodies(NamedTuple):
    """Free objects of a model at scale 1, as rigid bodies with all joints fixed in one state."""

    qpos: Int[np.ndarray, "free 7"]
    """Addresses of the objects' coordinates in qpos."""
    dof: Int[np.ndarray, "free 6"]
    """Addresses of the objects' velocities in qvel."""
    mass: Float[np.ndarray, " free"]
    center: Float[np.ndarray, "free 3"]
    """Centers of mass in the objects' frames [m]."""
    inertia: Float[np.ndarray, "free 3 3"]
    """Inertia about the centers of mass, in the objects' frames [kg m^2]."""


class Springs(NamedTuple):
    """Springs that hold the free objects of candidates; the leading axes are the candidates."""

    pos: Float[AnyArray, "*pop free 3"]
    """Target positions of the objects' origins in the world frame [m]."""
    quat: Float[AnyArray, "*pop free 4"]
    """Target rotations of the objects."""
    mass: Float[AnyArray, "*pop free"]
    center: Float[AnyArray, "*pop free 3"]
    inertia: Float[AnyArray, "*pop free 3 3"]


def free_bodies(m: mujoco.MjModel, qpos: Float[np.ndarray, " nq"]) -> FreeBodies:
    """Return the free objects of a model in the state `qpos`."""
    data = mujoco.MjData(m)
    data.qpos[:] = qpos
    for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_crb):
        stage(m, data)
    joints = np.flatnonzero(m.jnt_type == FREE)
    bodies = m.jnt_bodyid[joints]
    dof = m.jnt_dofadr[joints][:, None] + np.arange(6)
    mass_matrix = np.zeros((m.nv, m.nv))
    if m.nv:
        mujoco.mj_fullM(m, data, mass_matrix)
    mass = m.body_subtreemass[bodies]
    turn = data.xmat[bodies].reshape(-1, 3, 3)
    center = np.einsum("kji,kj->ki", turn, data.subtree_com[bodies] - data.xpos[bodies])
    about_origin = mass_matrix[dof[:, 3:, None], dof[:, None, 3:]]
    cross = np.cross(np.eye(3), center[:, None, :])
    shift = mass[:, None, None] * np.einsum("kij,klj->kil", cross, cross)
    return FreeBodies(
        m.jnt_qposadr[joints][:, None] + np.arange(7), dof, mass, center, about_origin - shift
    )


def springs(
    bodies: FreeBodies, start: Any, scale: Any = 1.0, mass: Any = None, xp: Any = np
) -> Springs:
    """Return springs that hold candidates at their placed coordinates.

    Args:
        bodies: the free objects at scale 1.
        start: placed coordinates of the free objects, shape [pop, free, 7]; the springs' targets.
        scale: scales of the free objects, shape [pop, free], or 1.
        mass: masses of the free objects, shape [pop, free]; if None, the masses at scale 1.
        xp: array module.
    """
    mass = xp.broadcast_to(bodies.mass, start.shape[:-1]) if mass is None else mass
    size = xp.broadcast_to(xp.asarray(scale), mass.shape)
    inertia = bodies.inertia * (size**2 * mass / bodies.mass)[..., None, None]
    return Springs(start[..., :3], start[..., 3:], mass, bodies.center * size[..., None], inertia)


class GuidedBodies(NamedTuple):
    """The free objects of candidates, and the springs that hold them."""

    bodies: FreeBodies
    springs: Springs

    def push(
        self, guidance: Guidance, time: Any, qpos: Any, qvel: Any, xp: Any = np
    ) -> tuple[Any, Any]:
        """Return the springs' `qfrc_applied` [pop, nv] at a time [s], and the limited `qvel`."""
        b = self.bodies
        free_qvel = qvel[..., b.dof]
        force = guidance.fade_factor(time, xp) * spring_forces(
            self.springs, guidance.rate, qpos[..., b.qpos], free_qvel, xp
        )
        free_qvel = limit_speed(free_qvel, guidance.max_speed, xp)
        if xp is np:
            applied, velocity = np.zeros_like(qvel), np.array(qvel)
            applied[..., b.dof], velocity[..., b.dof] = force, free_qvel
            return applied, velocity
        return jnp.zeros_like(qvel).at[..., b.dof].set(force), qvel.at[..., b.dof].set(free_qvel)

    def take(self, rows: Any) -> "GuidedBodies":
        """Select candidates along the leading axis."""
        return self._replace(springs=Springs(*(leaf[rows] for leaf in self.springs)))


def guided_bodies(scene: CompiledScene, poses: Poses, xp: Any = jnp) -> GuidedBodies:
    """Return the free objects of candidates, and springs that hold them at their placed poses."""
    static = scene.static
    m = static.mjm
    bodies = free_bodies(m, static.start)
    owner = static.jnt_object[m.jnt_type == FREE]
    scale = poses.scale[:, owner]
    masses = (static.body_object == owner[:, None]) * m.body_mass
    mass = xp.sum(masses * scale[..., None] ** static.powers.body_mass, axis=-1)
    if poses.variation is not None:
        mass = mass * poses.variation.mass[:, owner]
    start = xp.concatenate([poses.pos[:, owner], poses.quat[:, owner]], axis=-1)
    return GuidedBodies(bodies, springs(bodies, start, scale, mass, xp))


def spring_forces(s: Springs, rate: float, qpos: Any, qvel: Any, xp: Any = np) -> Any:
    """Return the generalized forces of the springs on free objects before fading.

    Args:
        s: the springs.
        rate: natural frequency [1/s].
        qpos: coordinates of the free objects, shape [pop, free, 7].
        qvel: velocities of the free objects, shape [pop, free, 6]: linear velocities in the world
            frame, angular velocities in the object's frame.
        xp: array module.

    Returns:
        Forces in the world frame [N] and torques in the object's frame [N m], [pop, free, 6].
    """
    turn, target = rotation(qpos[..., 3:], xp), rotation(s.quat, xp)
    spin = qvel[..., 3:]
    center = qpos[..., :3] + _apply(turn, s.center, xp)
    velocity = qvel[..., :3] + _apply(turn, xp.cross(spin, s.center), xp)
    offset = s.pos + _apply(target, s.center, xp) - center
    force = s.mass[..., None] * (rate**2 * offset - 2 * rate * velocity)
    # Rotation vector from the present to the target rotation, in the object's frame.
    relative = xp.einsum("...ji,...jk->...ik", turn, target)
    axis = xp.stack(
        [
            relative[..., 2, 1] - relative[..., 1, 2],
            relative[..., 0, 2] - relative[..., 2, 0],
            relative[..., 1, 0] - relative[..., 0, 1],
        ],
        axis=-1,
    )
    sine = xp.sqrt(xp.sum(axis**2, axis=-1) + LEAST_SINE**2) / 2
    cosine = (xp.trace(relative, axis1=-2, axis2=-1) - 1) / 2
    rotation_vector = axis / 2 * (xp.arctan2(sine, cosine) / sine)[..., None]
    torque = _apply(s.inertia, rate**2 * rotation_vector - 2 * rate * spin, xp)
    local = xp.einsum("...ji,...j->...i", turn, force)
    return xp.concatenate([force, torque + xp.cross(s.center, local)], axis=-1)


def limit_speed(qvel: Any, max_speed: float, xp: Any = np) -> Any:
    """Return velocities [pop, free, 6] whose linear speed is limited to `max_speed` [m/s]."""
    speed = xp.sqrt(xp.sum(qvel[..., :3] ** 2, axis=-1, keepdims=True))
    return qvel * xp.minimum(1.0, max_speed / xp.maximum(speed, 1e-12))


def _apply(matrix: Any, vector: Any, xp: Any) -> Any:
    return xp.einsum("...ij,...j->...i", matrix, vector)

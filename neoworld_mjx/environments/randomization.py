"""Initial states of episodes: noise about a scene, or draws of `nw.sample` as worlds of a batch."""

import copy
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from ..errors import SpecError
from ..physics.layout import Layout
from ..physics.model_fields import model_fields
from ..spec import Camera
from .controlled_scene import ControlledScene
from .samples import SceneSamples, sample


@dataclass(frozen=True)
class ResetNoise:
    """Standard deviations of the noise that every reset adds to the scene."""

    xy: float = 0.0
    """Standard deviation of the x and y position of each movable object [m]."""
    yaw: float = 0.0
    """Standard deviation of the yaw of each movable object [rad]."""
    joints: float = 0.0
    """Standard deviation of each joint position, as a fraction of the joint's range (of a full turn
    for a joint without limits)."""


def draw_start(controlled: ControlledScene, key: Array, noise: ResetNoise) -> Float[Array, " nq"]:
    """Draw the initial qpos of an episode. JAX can trace this function.

    Each object moves in the frame of its parent, together with the objects on it, and is placed at
    the height of its support. Joint positions are clipped to the joints' ranges.
    """
    qpos = jnp.asarray(controlled.initial_qpos, jnp.float32)
    keys = jax.random.split(key, 4)
    count, scene, model = len(controlled.names), controlled.scene, controlled.model
    if noise.xy or noise.yaw:
        xy = noise.xy * jax.random.normal(keys[0], (1, count, 2)) * scene.movable[:, None]
        yaw = noise.yaw * jax.random.normal(keys[1], (1, count)) * scene.movable
        placed = scene.place(Layout(xy, yaw, jnp.zeros((1, count))))
        scene_qpos = model_fields(scene, placed)["qpos"][0]
        qpos = qpos.at[: scene_qpos.shape[0]].set(scene_qpos)
    if noise.joints and len(controlled.joints):
        joints = [model.joint(name).id for name in controlled.joints]
        limited = model.jnt_limited[joints].astype(bool)
        low, high = model.jnt_range[joints].T
        width = np.where(limited, high - low, 2 * np.pi)
        draw = noise.joints * width * jax.random.normal(keys[2], (len(joints),))
        sampled = qpos[controlled.qpos_of_joints] + draw
        clipped = jnp.where(limited, jnp.clip(sampled, low, high), sampled)
        qpos = qpos.at[controlled.qpos_of_joints].set(clipped)
    return qpos


FIELDS = (
    *("body_pos", "body_quat", "body_ipos", "body_mass", "body_inertia"),
    *("geom_pos", "geom_size", "geom_rbound", "geom_aabb", "geom_friction"),
    *("jnt_pos", "jnt_range", "dof_damping", "dof_frictionloss", "qpos0", "qpos_spring"),
)
"""Fields in which draws may differ. The derived fields follow by `mj_setConst`."""
DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0")


@dataclass(frozen=True, eq=False)
class Variants:
    """Variants of a controlled scene that differ in fields of the model."""

    qpos: Float[np.ndarray, "variant nq"]
    ctrl: Float[np.ndarray, "variant nu"]
    """Initial controls."""
    fields: dict[str, np.ndarray]
    """Only fields in which the variants differ, each of shape [variant, ...]."""
    cameras: tuple[Camera | None, ...] = ()
    """The camera of each variant's photograph."""

    def __len__(self) -> int:
        return len(self.qpos)


def variants_of(controlled: ControlledScene, samples: SceneSamples) -> Variants:
    """Return the kept draws of a scene as variants of the scene with its robot or gripper.

    Raises:
        SpecError: no draw is kept, or the draws vary the sizes of meshes, which the worlds of a
            batch share.
    """
    if not len(samples.kept):
        raise SpecError(f"no draw of the scene is kept: {samples.phrase()}")
    poses = jax.tree.map(lambda leaf: np.asarray(leaf, float)[samples.kept], samples.poses)
    base = samples.model.static.mjm
    if base.nmesh and not np.allclose(poses.scale, 1.0, atol=1e-6):
        raise SpecError("worlds of a batch share their meshes: sample with sizes=False")
    values = model_fields(samples.model, poses, np)
    model, count = controlled.model, len(poses.scale)
    qpos = np.tile(controlled.initial_qpos, (count, 1))
    qpos[:, : base.nq] = values["qpos"]
    scratch, data = copy.copy(model), mujoco.MjData(model)
    fields: dict[str, list[np.ndarray]] = {name: [] for name in FIELDS + DERIVED}
    for k in range(count):
        for name in FIELDS:
            # The bodies, geoms and joints of the scene come first in the model.
            target, source = getattr(scratch, name), values.get(name)
            if source is not None:
                rows = source[k].reshape(-1, *target.shape[1:])
                target[: len(rows)] = rows
        mujoco.mj_setConst(scratch, data)
        for name, rows in fields.items():
            rows.append(getattr(scratch, name).astype(np.float32))
    stacked = {name: np.stack(rows) for name, rows in fields.items()}
    differing = {
        name: v for name, v in stacked.items() if not np.allclose(v, getattr(model, name), 1e-6)
    }
    ctrl = np.tile(controlled.initial_ctrl, (count, 1))
    cameras = tuple(samples.cameras[k] for k in samples.kept)
    return Variants(qpos.astype(np.float32), ctrl.astype(np.float32), differing, cameras)


def scene_variants(controlled: ControlledScene, n: int, seed: int) -> Variants | None:
    """Return the kept ones of `n` draws of a scene; None for 0.

    Sizes vary only if no collider is a mesh, because the worlds of a batch share their meshes.
    """
    if n < 0:
        raise SpecError(f"samples: {n}, not 0 or more")
    if n == 0:
        return None
    scene = controlled.scene
    drawn = sample(scene, n, seed=seed, sizes=not scene.static.mjm.nmesh)
    return variants_of(controlled, drawn)

"""Noise of the initial states of episodes."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics.layout import Layout
from ..physics.model_fields import model_fields
from ..physics.posterior import pose_factor
from ..spec.correlation import EACH
from .controlled_scene import ControlledScene


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
    photo: float = 0.0
    """Factor of additional noise of the position and yaw of each aligned object, fixed objects
    included. At 1, the noise has the standard deviations and correlations that the photograph
    leaves, as the draws of `neoworld_mjx.sample`. A round object is not turned, because every
    heading looks the same. Sizes do not vary."""
    camera: float = 0.0
    """Factor of the noise of the camera in pictures, at 1 as the photograph leaves it. It is drawn
    together with `photo`, so both at 1 have the correlations of the estimate."""


class Start(NamedTuple):
    """Initial state of an episode."""

    qpos: Float[Array, " nq"]
    fields: dict[str, Array]
    """Model fields in which the episode differs: of fixed objects that move, the position and
    orientation of each body in its parent body."""
    camera: Float[Array, " 4"]
    """Change of the camera of pictures; see `posterior.Draws.camera`."""


def draw_start(controlled: ControlledScene, key: Array, noise: ResetNoise) -> Start:
    """Draw the initial state of an episode. JAX can trace this function.

    Each object moves in the frame of its parent, together with the objects on it, and is placed at
    the height of its support. Joint positions are clipped to the joints' ranges.
    """
    qpos = jnp.asarray(controlled.initial_qpos, jnp.float32)
    keys = jax.random.split(key, 4)
    count, scene, model = len(controlled.names), controlled.scene, controlled.model
    fields, camera = dict[str, Array](), jnp.zeros(EACH)
    if noise.xy or noise.yaw or noise.photo or noise.camera:
        own = noise.xy * jax.random.normal(keys[0], (1, count, 2)) * scene.movable[:, None]
        turn = noise.yaw * jax.random.normal(keys[1], (1, count)) * scene.movable
        factor = jnp.asarray(pose_factor(scene.spec), jnp.float32)
        values = factor @ jax.random.normal(keys[3], (factor.shape[1],))
        camera = noise.camera * values[:EACH]
        drawn = noise.photo * values[EACH:].reshape(1, count, EACH)
        drawn = drawn * scene.optimised[:, None]
        layout = Layout(own + drawn[..., :2], turn + drawn[..., 2], jnp.zeros((1, count)))
        placed = scene.place(layout)
        scene_qpos = model_fields(scene, placed)["qpos"][0]
        qpos = qpos.at[: scene_qpos.shape[0]].set(scene_qpos)
        movable, optimised = (np.asarray(x) for x in (scene.movable, scene.optimised))
        fixed = np.flatnonzero(optimised & ~movable)
        if noise.photo and len(fixed):
            roots = controlled.bodies[fixed]
            for name, values in (("body_pos", placed.pos), ("body_quat", placed.quat)):
                whole = jnp.asarray(getattr(model, name), jnp.float32)
                fields[name] = whole.at[roots].set(values[0, fixed])
    if noise.joints and len(controlled.joints):
        joints = [model.joint(name).id for name in controlled.joints]
        limited = model.jnt_limited[joints].astype(bool)
        low, high = model.jnt_range[joints].T
        width = np.where(limited, high - low, 2 * np.pi)
        draw = noise.joints * width * jax.random.normal(keys[2], (len(joints),))
        sampled = qpos[controlled.qpos_of_joints] + draw
        clipped = jnp.where(limited, jnp.clip(sampled, low, high), sampled)
        qpos = qpos.at[controlled.qpos_of_joints].set(clipped)
    return Start(qpos, fields, camera)

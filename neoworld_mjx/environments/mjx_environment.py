"""Environment of a scene for `jax.vmap`, with the interface of MuJoCo Playground."""

from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from mujoco import mjx

from ..physics.gripper import Gripper
from ..physics.mjx_model import MjxModel, make_data, mjx_step, put_compiled, with_fields
from ..spec import SceneSpec
from .arm import scene_state
from .controlled_scene import ControlledScene, ResetNoise, controlled_scene

Observation = dict[str, Array]
"""Observations by name:

- poses [object, 7]: position [m] and quaternion (w, x, y, z) of each object's root body;
- joints, joint_velocities [joint]: joint positions [rad or m] and velocities [rad/s or m/s];
- gripper [8], if the scene has a gripper: pose of the tool, and distance between the pads [m].
"""
Reward = Callable[[Observation], Float[Array, ""]]


class EnvState(eqx.Module):
    """State of one environment, with the field names of MuJoCo Playground."""

    data: mjx.Data
    obs: Observation
    reward: Float[Array, ""]
    done: Float[Array, ""]
    """1 if the simulation has diverged, otherwise 0."""
    metrics: dict[str, Array]
    info: dict[str, Array]
    """The entry `step` is the number of steps since the last reset. With `ResetNoise.photo`,
    `body_pos` and `body_quat` are the poses of bodies in their parents, in which fixed objects
    differ."""


class MjxEnv:
    """Environment whose methods `reset` and `step` are pure: they can be jitted and vmapped."""

    def __init__(
        self,
        controlled: ControlledScene,
        *,
        reward: Reward | None,
        noise: ResetNoise,
        control_s: float,
    ) -> None:
        self.controlled = controlled
        self.mjx_model: MjxModel = put_compiled(controlled.model, controlled.initial_qpos)
        self._data = make_data(self.mjx_model)
        self._reward, self._noise = reward, noise
        self.n_substeps = max(round(control_s / controlled.model.opt.timestep), 1)

    @property
    def action_size(self) -> int:
        """Length of an action: the drives' targets, followed by the gripper's seven targets."""
        return len(self.controlled.hold_action)

    def reset(self, key: Array) -> EnvState:
        """Start an episode, with noise that depends on a random key. JAX can trace this method."""
        qpos, pos, quat = self.controlled.reset_state(key, self._noise)
        hold = jnp.asarray(self.controlled.initial_ctrl, jnp.float32)
        data = jax.tree.map(jnp.asarray, self._data).replace(qpos=qpos, ctrl=hold)
        info = {"step": jnp.zeros((), jnp.int32)}
        if self._noise.photo and len(self.controlled.fixed):
            info |= {"body_pos": jnp.asarray(pos), "body_quat": jnp.asarray(quat)}
        return self._state(mjx.kinematics(self._model(info).mjx, data), info)

    def step(self, state: EnvState, action: Float[Array, " action"]) -> EnvState:
        """Apply an action, clipped to its bounds, for one control interval.

        JAX can trace this method.
        """
        ctrl = self.controlled.controls(action, scene_state(state.data), jnp)
        data = state.data.replace(ctrl=ctrl)
        model = self._model(state.info)
        data = mjx_step(model, data, self.n_substeps)
        # Body poses in the data lag one time step behind qpos.
        data = mjx.kinematics(model.mjx, data)
        return self._state(data, state.info | {"step": state.info["step"] + 1})

    def _model(self, info: dict[str, Array]) -> MjxModel:
        """Return the model in which fixed objects have the poses of the episode."""
        fields = {name: info[name] for name in ("body_pos", "body_quat") if name in info}
        return with_fields(self.mjx_model, fields) if fields else self.mjx_model

    def _state(self, data: mjx.Data, info: dict[str, Array]) -> EnvState:
        obs = self.controlled.observe(scene_state(data), jnp)
        done = jnp.any(~jnp.isfinite(data.qpos)).astype(jnp.float32)
        reward = jnp.zeros(()) if self._reward is None else jnp.asarray(self._reward(obs))
        return EnvState(data, obs, reward, done, {}, info)


def mjx_env(
    run: Path | str | SceneSpec,
    *,
    gripper: Gripper | str | None = None,
    drive_joints: bool | None = None,
    reward: Reward | None = None,
    noise: ResetNoise | None = None,
    control_s: float = 0.02,
) -> MjxEnv:
    """Return an environment of a run folder, a scene.json or a scene, for use with `jax.vmap`.

    Args:
        run: the folder, file or scene.
        gripper: initial pose of a free-flying gripper, or the name <object>-<frame> of the handle
            that the gripper faces. If None, there is no gripper.
        drive_joints: if True, actions include targets of the joints. If None, they do so only if
            there is no gripper.
        reward: function that maps an observation to the reward and that JAX can trace; if None, the
            reward is 0.
        noise: noise that each reset adds to the scene; if None, no noise.
        control_s: duration of each action [s].

    Raises:
        SpecError: there is no scene, the handle does not exist, or there is nothing to actuate.
        EngineError: MJX cannot simulate the scene.
    """
    controlled = controlled_scene(run, gripper=gripper, drive_joints=drive_joints, mjx=True)
    return MjxEnv(controlled, reward=reward, noise=noise or ResetNoise(), control_s=control_s)

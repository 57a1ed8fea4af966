"""A scene's environment for `jax.vmap`, with reset and step as those of MuJoCo Playground."""

from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from mujoco import mjx

from ..physics.gripper import PREFIX, Gripper
from ..physics.mjx_model import MjxModel, make_data, mjx_step, put_compiled
from ..spec import SceneSpec
from .controlled_scene import ControlledScene, ResetNoise, controlled_scene

Observation = dict[str, Array]
"""What is observed, by name:

poses [object, 7]: position [m] and rotation (w, x, y, z) of every object's root;
joints, joint_velocities [joint]: [rad or m, and per s];
gripper [8], where there is one: the tool's pose, and the distance of the pads [m].
"""
Reward = Callable[[Observation], Float[Array, ""]]


class EnvState(eqx.Module):
    """State of one environment; fields are named as MuJoCo Playground names them."""

    data: mjx.Data
    obs: Observation
    reward: Float[Array, ""]
    done: Float[Array, ""]
    """1 where the simulation has diverged."""
    metrics: dict[str, Array]
    info: dict[str, Array]
    """step: how many steps the episode has had."""


class MjxEnv:
    """Pure functions of a key, or of a state and an action: to be jitted and vmapped."""

    def __init__(
        self,
        controlled: ControlledScene,
        *,
        reward: Reward | None,
        noise: ResetNoise,
        control_s: float,
    ) -> None:
        self.controlled = controlled
        self.mjx_model: MjxModel = put_compiled(controlled.model, controlled.start)
        self._data = make_data(self.mjx_model)
        self._reward, self._noise = reward, noise
        self.n_substeps = max(round(control_s / controlled.model.opt.timestep), 1)

    @property
    def action_size(self) -> int:
        """Numbers in an action: targets of the driven joints, then the gripper's seven."""
        return len(self.controlled.hold)

    def reset(self, key: Array) -> EnvState:
        """Start an episode. Traceable.

        Args:
            key: of the noise.
        """
        qpos = self.controlled.reset_state(key, self._noise)
        hold = self.controlled.controls(self.controlled.hold, jnp)
        data = jax.tree.map(jnp.asarray, self._data).replace(qpos=qpos, ctrl=hold)
        data = mjx.kinematics(self.mjx_model.mjx, data)
        return self._state(data, jnp.zeros((), jnp.int32))

    def step(self, state: EnvState, action: Float[Array, " action"]) -> EnvState:
        """Hold targets for one control interval. Traceable.

        Args:
            state: of one environment.
            action: targets, held within their bounds.
        """
        data = state.data.replace(ctrl=self.controlled.controls(action, jnp))
        data = mjx_step(self.mjx_model, data, self.n_substeps)
        # A step leaves places as they were before its last time step.
        data = mjx.kinematics(self.mjx_model.mjx, data)
        return self._state(data, state.info["step"] + 1)

    def _state(self, data: mjx.Data, step: Array) -> EnvState:
        obs = self._observe(data)
        done = jnp.any(~jnp.isfinite(data.qpos)).astype(jnp.float32)
        reward = jnp.zeros(()) if self._reward is None else jnp.asarray(self._reward(obs))
        return EnvState(data, obs, reward, done, {}, {"step": step})

    def _observe(self, data: mjx.Data) -> Observation:
        own = self.controlled
        result = {
            "poses": jnp.concatenate([data.xpos[own.bodies], data.xquat[own.bodies]], axis=1),
            "joints": data.qpos[own.qpos_of_joints],
            "joint_velocities": data.qvel[own.dof_of_joints],
        }
        if own.gripper is not None:
            hand = own.model.body(f"{PREFIX}-hand").id
            fingers = np.array(
                [own.model.joint(f"{PREFIX}-{side}").qposadr[0] for side in ("left", "right")]
            )
            wide = jnp.sum(data.qpos[fingers])[None]
            result["gripper"] = jnp.concatenate([data.xpos[hand], data.xquat[hand], wide])
        return result


def mjx_env(
    run: Path | str | SceneSpec,
    *,
    gripper: Gripper | str | None = None,
    drive_joints: bool | None = None,
    reward: Reward | None = None,
    noise: ResetNoise | None = None,
    control_s: float = 0.02,
) -> MjxEnv:
    """Make an environment for `jax.vmap` of a run folder, a scene.json or a scene.

    Args:
        run: the folder, file or scene.
        gripper: where a free gripper starts, or the handle, <object>-<frame>, that it faces.
        drive_joints: whether actions hold the joints' targets; by default without a gripper.
        reward: takes an observation and returns a number; traceable.
        noise: what every reset adds to the scene; none by default.
        control_s: how long each action lasts [s].

    Raises:
        SpecError: there is no scene, no such handle, or nothing to act on.
        EngineError: the scene has something that MJX cannot simulate.
    """
    controlled = controlled_scene(run, gripper=gripper, drive_joints=drive_joints, mjx=True)
    return MjxEnv(controlled, reward=reward, noise=noise or ResetNoise(), control_s=control_s)

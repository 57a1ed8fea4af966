"""Training of a policy in an environment."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .mjx_environment import EnvState, MjxEnv
from .networks import flat

STEP_M, STEP_RAD = 0.03, 0.15
"""Change of the target of a flying gripper by an action of 1."""


class TrainState(eqx.Module):
    """State of an environment whose observation is a vector."""

    env: EnvState
    obs: Array
    reward: Array
    done: Array
    metrics: dict[str, Array]


class PolicyEnv:
    """Environment as a policy sees it: a vector of observations, actions of about 1."""

    def __init__(self, env: MjxEnv, horizon: int, success: Any = None) -> None:
        self.env, self.horizon, self._success = env, horizon, success
        self.action_size = env.action_size

    def reset(self, key: Array) -> TrainState:
        """Return an initial state."""
        return self._state(self.env.reset(key))

    def step(self, state: TrainState, action: Array) -> TrainState:
        """Return the next state."""
        return self._state(self.env.step(state.env, self.scaled(state.env, action)))

    def scaled(self, state: EnvState, action: Array) -> Array:
        """Return the action of the environment."""
        scene = self.env.controlled
        a = jnp.clip(action, -1.0, 1.0)
        low, high = scene.action_bounds
        middle, half = (low + high) / 2, (high - low) / 2
        if scene.gripper is None:  # the bounds of a robot's tool control are -1 and 1
            return middle + half * a
        n = len(scene.drives)
        changes = jnp.array([STEP_M] * 3 + [STEP_RAD] * 3)
        moved = jnp.clip(state.data.ctrl[n : n + 6] + changes * a[n : n + 6], low[n:-1], high[n:-1])
        absolute = middle + half * a
        return jnp.concatenate([absolute[:n], moved, absolute[-1:]])

    def _state(self, state: EnvState) -> TrainState:
        metrics = {} if self._success is None else {"success": self._success(state) * 1.0}
        return TrainState(state, flat(state.obs), state.reward, state.done, metrics)


def block(x: Any) -> Any:
    """Wait for arrays."""
    return jax.block_until_ready(x)

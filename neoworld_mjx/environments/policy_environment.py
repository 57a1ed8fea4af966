"""A task as a policy sees it: a vector of observations, and actions of about 1 in size."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..errors import SpecError
from ..spec.pose import rotate
from .arm import SceneState, scene_state
from .controlled_scene import ControlledScene
from .mjx_environment import EnvState, MjxEnv
from .networks import flat
from .predicates import BACK
from .task import SceneTask, StateView

STEP_M, STEP_RAD = 0.02, 0.08
"""Change of the target of a flying gripper by an action of 1, as of a robot."""


def policy_observation(task: SceneTask, state: SceneState, xp: Any = jnp) -> Any:
    """Return all observations as one vector, shape [obs].

    They are those of the environment in the order of their names; then where the point of the task
    is from the tool, in the axes of the tool [m]; and the progress.
    """
    scene = task.controlled
    pos, quat = scene.tool(state, xp)
    apart = StateView(scene, state).point(task.task.point) - pos
    near = rotate(quat * BACK, apart, xp)
    own = {"near": near, "progress": xp.reshape(task.progress(state), (1,))}
    return xp.concatenate([flat(scene.observe(state, xp), xp), flat(own, xp)])


def policy_action(scene: ControlledScene, state: SceneState, action: Any, xp: Any = jnp) -> Any:
    """Return the environment's action for the action of a policy.

    A flying gripper moves its target by changes and closes at 0 and below, as a robot does.
    """
    a = xp.clip(action, -1.0, 1.0)
    low, high = scene.action_bounds
    absolute = (low + high) / 2 + (high - low) / 2 * a
    if scene.gripper is None:
        return absolute
    n = len(scene.drives)
    change = np.array([STEP_M] * 3 + [STEP_RAD] * 3, np.float32) * a[n : n + 6]
    moved = xp.clip(state.ctrl[n : n + 6] + change, low[n:-1], high[n:-1])
    return xp.concatenate([absolute[:n], moved, high[-1:] * xp.maximum(a[-1:], 0.0)])


class TaskState(eqx.Module):
    """State of an environment whose observation is a vector."""

    env: EnvState
    obs: Array
    reward: Array
    done: Array
    metrics: dict[str, Array]
    delay: Array
    """Control steps after which an action acts; the initial state is held until the first does."""
    recent: Array
    """Latest actions, the last one first, shape [largest delay, action]."""


class PolicyEnv:
    """Environment of a task for the optimization; see `ppo.Trainable`."""

    def __init__(self, env: MjxEnv, horizon: int, delay_steps: int = 0) -> None:
        if env.task is None:
            raise SpecError("the environment of a policy needs a task")
        self.env, self.task, self.horizon = env, env.task, horizon
        self.action_size = env.action_size
        self._start = jnp.zeros((delay_steps, env.action_size))

    def reset(self, key: Array) -> TaskState:
        """Return an initial state."""
        delay = jax.random.randint(jax.random.fold_in(key, 1), (), 0, len(self._start) + 1)
        return self._state(self.env.reset(key), delay, self._start)

    def reset_to(self, row: Array) -> TaskState:
        """Return the initial state of one of the variants."""
        return self._state(self.env.reset_to(row), row % (len(self._start) + 1), self._start)

    def step(self, state: TaskState, action: Array) -> TaskState:
        """Return the next state."""
        now = scene_state(state.env.data)
        controlled, recent = self.env.controlled, jnp.stack([action, *state.recent])
        acts = policy_action(controlled, now, recent[state.delay])
        acts = jnp.where(state.env.info["step"] < state.delay, controlled.hold_action, acts)
        return self._state(self.env.step(state.env, acts), state.delay, recent[:-1])

    def _state(self, state: EnvState, delay: Array, recent: Array) -> TaskState:
        world = scene_state(state.data)
        obs = policy_observation(self.task, world)
        return TaskState(state, obs, state.reward, state.done, state.metrics, delay, recent)

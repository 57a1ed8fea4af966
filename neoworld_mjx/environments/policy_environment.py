"""A task as a policy sees it: a vector of observations, and actions of about 1 in size."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..errors import SpecError
from ..spec.pose import rotate
from .arm import SceneState
from .controlled_scene import ControlledScene
from .mjx_environment import EnvState, MjxEnv
from .networks import flat
from .predicates import BACK, Located, leaves, named_objects
from .task import SceneTask, StateView

STEP_M, STEP_RAD = 0.02, 0.08
"""Change of the target of a flying gripper by an action of 1, as of a robot."""


def policy_observation(task: SceneTask, state: SceneState, xp: Any = jnp) -> Any:
    """Return what a policy observes of a state as one vector, shape [obs].

    It observes the tool, the point of the task, the goal and the objects that the task names, but
    no others, and no position in the world: a policy acts alike wherever its objects are, and fits
    other scenes with these objects. Positions are relative to the tool [m].
    """
    scene, view = task.controlled, StateView(task.controlled, state)
    goal, point = task.task.goal, task.task.point
    pos, quat = scene.tool(state, xp)
    named = named_objects(goal) | {point.object}
    seen = {
        "near": rotate(quat * BACK, view.point(point) - pos, xp),
        "orientation": quat,
        "opening": xp.reshape(view.opening(), (1,)),
        "progress": xp.reshape(task.progress(state), (1,)),
    }
    for k, leaf in enumerate(leaves(goal)):
        if isinstance(leaf, Located):
            seen[f"goal {k}"] = leaf.offset(view)
    for item in scene.scene.spec.objects:
        if item.name in named and not item.environment:
            at, turn = view.pose(item.name)
            seen |= {f"position {item.name}": at - pos, f"turn {item.name}": turn}
            own = [k for k, n in enumerate(scene.joints) if n.split("-", 1)[0] == item.name]
            seen[f"joints {item.name}"] = state.qpos[scene.qpos_of_joints[own]]
            seen[f"velocities {item.name}"] = state.qvel[scene.dof_of_joints[own]]
    if scene.arm is not None:
        seen |= scene.arm.observe(state, xp)
        del seen["gripper"]  # its position in the world
    elif scene.gripper is not None:
        seen["target"] = state.ctrl[:3] + np.array(scene.gripper.pos, np.float32) - pos
        seen["target_turn"] = state.ctrl[3:6]
    return flat(seen, xp)


def policy_action(scene: ControlledScene, state: SceneState, action: Any, xp: Any = jnp) -> Any:
    """Return the environment's action for the action of a policy.

    A flying gripper moves its target by changes and closes at 0 and below, as a robot does.
    """
    a = xp.clip(action, -1.0, 1.0)
    if scene.gripper is None:
        return a
    low, high = scene.action_bounds
    change = np.array([STEP_M] * 3 + [STEP_RAD] * 3, np.float32) * a[:6]
    moved = xp.clip(state.ctrl[:6] + change, low[:6], high[:6])
    return xp.concatenate([moved, high[-1:] * xp.maximum(a[-1:], 0.0)])


class Script(NamedTuple):
    """Motion that is written, not learned; episodes of training may start along it."""

    action: Callable[[SceneState, SceneState, Array], Array]
    """Maps the state, the initial state and the number of the step to an environment's action."""
    steps: int


SCRIPTED = 0.5
"""Share of the initial states that lie along the script."""


class PolicyEnv:
    """Environment of a task for the optimization; see `ppo.Trainable`."""

    def __init__(
        self,
        env: MjxEnv,
        horizon: int,
        script: Script | None = None,
        delay_steps: int = 0,
    ) -> None:
        if env.task is None:
            raise SpecError("the environment of a policy needs a task")
        self.env, self.task, self.horizon, self._script = env, env.task, horizon, script
        self.action_size = env.action_size
        self._start = jnp.zeros((delay_steps, env.action_size))

    def reset(self, key: Array) -> EnvState:
        """Return an initial state; with a script, half of them lie along it.

        Starts along a motion that reaches the goal make far rewards known early (Peng et al.,
        DeepMimic, 2018: reference state initialization).
        """
        keys = jax.random.split(key, 4)
        start = self.env.reset(keys[0])
        delay = jax.random.randint(keys[3], (), 0, len(self._start) + 1)
        script = self._script
        if script is None:
            return self._observed(start, delay, self._start)
        moved = jax.random.uniform(keys[1]) < SCRIPTED
        until = jnp.where(moved, jax.random.randint(keys[2], (), 0, script.steps), 0)

        def advance(t: Array, state: EnvState) -> EnvState:
            after = self.env.step(state, script.action(state.data, start.data, t))
            going = (t < until) & (after.done == 0)
            return jax.tree.map(lambda new, old: jnp.where(going, new, old), after, state)

        state = jax.lax.fori_loop(0, script.steps, advance, start)
        return self._observed(state, delay, self._start)

    def reset_to(self, row: Array) -> EnvState:
        """Return the initial state of one of the variants."""
        return self._observed(self.env.reset_to(row), row % (len(self._start) + 1), self._start)

    def step(self, state: EnvState, action: Array) -> EnvState:
        """Return the next state."""
        delay, recent = state.info["delay"], jnp.stack([action, *state.info["recent"]])
        acts = policy_action(self.env.controlled, state.data, recent[delay])
        acts = jnp.where(state.info["step"] < delay, self.env.controlled.hold_action, acts)
        return self._observed(self.env.step(state, acts), delay, recent[:-1])

    def _observed(self, state: EnvState, delay: Array, recent: Array) -> EnvState:
        """Return a state with the policy's observation and what delays its actions.

        The initial state is held until the first action acts.
        """
        info = state.info | {"delay": delay, "recent": recent}
        return replace(state, obs=policy_observation(self.task, state.data), info=info)

"""Environment of a scene for `jax.vmap`, with the interface of MuJoCo Playground.

The same pure functions run on C MuJoCo (in threads), MuJoCo Warp and MJX; see `engines`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float

from ..errors import SpecError
from ..physics.engine import open_engine
from ..spec import SceneSpec, read_scene
from .arm import scene_state
from .controlled_scene import ControlledScene, ResetNoise, SceneOptions, controlled_scene
from .engines import WorldState, initial_world, open_steps
from .own_reward import Reward, traced_reward
from .randomization import Variants
from .reach import propose_mount
from .simplified_scene import scene_without
from .task import SceneTask, Task
from .task_words import task_of

Observation = dict[str, Array]
"""Observations by name; see `ControlledScene.observe`."""
WORLDS = 4096
"""Number of worlds for which warp allocates memory, unless stated."""


FASTEST, FARTHEST = 1e3, 1e3
"""Velocities [m/s or rad/s] and positions [m or rad] from which a simulation has diverged."""


class EnvState(eqx.Module):
    """State of one environment, with the field names of MuJoCo Playground."""

    data: WorldState
    obs: Observation
    reward: Float[Array, ""]
    done: Float[Array, ""]
    """1 if the simulation has diverged, otherwise 0."""
    metrics: dict[str, Array]
    """`success` (0 or 1) and `progress` (0 to 1) of the task, if there is one."""
    info: dict[str, Array]
    """`step`: number of steps since the last reset; `sample`: row of the variants; `body_pos` and
    `body_quat`, with `ResetNoise.photo`: poses of bodies in their parents."""


class MjxEnv:
    """Environment whose methods `reset` and `step` are pure: they can be jitted and vmapped."""

    def __init__(
        self,
        controlled: ControlledScene,
        *,
        task: SceneTask | None = None,
        reward: Reward | None = None,
        noise: ResetNoise | None = None,
        variants: Variants | None = None,
        engine: str | None = None,
        worlds: int = WORLDS,
        control_s: float = 0.02,
    ) -> None:
        self.controlled, self.task = controlled, task
        self._reward = None if task is None else task.reward
        if reward is not None:
            state = scene_state(mujoco.MjData(controlled.model))
            obs = controlled.observe(state)
            self._reward = traced_reward(reward, obs, controlled.hold_action, state, state)
        self._noise, self._variants = noise or ResetNoise(), variants
        if variants is not None and self._noise != ResetNoise():
            raise SpecError("an environment takes samples or noise, not both")
        self.steps = open_steps(controlled, engine or open_engine().name, worlds)
        self.control_s = control_s
        self.n_substeps = max(round(control_s / controlled.model.opt.timestep), 1)

    @property
    def engine(self) -> str:
        """Name of the engine."""
        return self.steps.name

    @property
    def action_size(self) -> int:
        """Length of an action."""
        return len(self.controlled.hold_action)

    def reset(self, key: Array) -> EnvState:
        """Start an episode, in a random one of the variants or with noise.

        JAX can trace this method.
        """
        if self._variants is not None:
            return self.reset_to(jax.random.randint(key, (), 0, len(self._variants)))
        qpos, pos, quat, _ = self.controlled.reset_state(key, self._noise)
        moved = self._noise.photo and len(self.controlled.fixed)
        fields = {"body_pos": jnp.asarray(pos), "body_quat": jnp.asarray(quat)}
        return self._start(jnp.asarray(qpos), fields if moved else {})

    def reset_to(self, row: Array) -> EnvState:
        """Start an episode in one of the variants. JAX can trace this method."""
        if self._variants is None:
            raise SpecError("the environment has no variants")
        ctrl = self._variants.ctrl
        ctrl = self.controlled.initial_ctrl if ctrl is None else jnp.asarray(ctrl)[row]
        return self._start(jnp.asarray(self._variants.qpos)[row], {"sample": row}, ctrl)

    def _start(self, qpos: Array, own: dict[str, Array], ctrl: Any = None) -> EnvState:
        info = {"step": jnp.zeros((), jnp.int32), **own}
        ctrl = self.controlled.initial_ctrl if ctrl is None else ctrl
        start = initial_world(self.controlled.model, qpos, ctrl)
        world = self.steps.step(self._fields(info), start, jnp.asarray(start.ctrl), 0)
        return self._state(world, world, jnp.zeros(self.action_size), info)

    def step(self, state: EnvState, action: Float[Array, " action"]) -> EnvState:
        """Apply an action, clipped to its bounds, for one control interval.

        JAX can trace this method.
        """
        ctrl = self.controlled.controls(action, scene_state(state.data), jnp)
        world = self.steps.step(self._fields(state.info), state.data, ctrl, self.n_substeps)
        info = state.info | {"step": state.info["step"] + 1}
        return self._state(world, state.data, action, info)

    def _fields(self, info: dict[str, Array]) -> dict[str, Array]:
        """Return the model fields in which this episode differs."""
        if self._variants is not None:
            row = info["sample"]
            return {k: jnp.asarray(v)[row] for k, v in self._variants.fields.items()}
        return {name: info[name] for name in ("body_pos", "body_quat") if name in info}

    def _state(
        self, world: WorldState, previous: WorldState, action: Array, info: dict[str, Array]
    ) -> EnvState:
        obs = self.controlled.observe(scene_state(world), jnp)
        whole = world.xpos, world.xquat, world.qacc_warmstart
        finite = jnp.all(jnp.abs(world.qvel) < FASTEST) & jnp.all(jnp.abs(world.qpos) < FARTHEST)
        for values in whole:
            finite &= jnp.all(jnp.isfinite(values))
        reward = jnp.zeros(())
        if self._reward is not None:
            now, before = scene_state(world), scene_state(previous)
            reward = jnp.asarray(self._reward(obs, action, now, before), jnp.float32)
        done = 1.0 - finite.astype(jnp.float32)
        metrics: dict[str, Array] = {}
        if self.task is not None:
            now = scene_state(world)
            metrics = {"success": self.task.success(now), "progress": self.task.progress(now)}
            metrics = {k: jnp.where(finite, v, 0).astype(jnp.float32) for k, v in metrics.items()}
        return EnvState(world, obs, jnp.where(finite, reward, 0.0), done, metrics, info)


def scene_of(
    run: Path | str | SceneSpec,
    task: Task | str | None,
    without: Sequence[str],
    scene_options: SceneOptions,
) -> tuple[SceneSpec, Task | None]:
    """Return the initial scene and the task; a robot without a mount gets one in the options."""
    scene = scene_without(run if isinstance(run, SceneSpec) else read_scene(Path(run)), without)
    if task is None:
        return scene, None
    task = task_of(scene, task) if isinstance(task, str) else task
    robot = scene_options.get("robot")
    if robot is not None and scene_options.get("mount") is None:
        scene_options["mount"] = propose_mount(task, robot)
    return task.scene, task


def mjx_env(
    run: Path | str | SceneSpec,
    *,
    task: Task | str | None = None,
    without: Sequence[str] = (),
    reward: Reward | None = None,
    noise: ResetNoise | None = None,
    variants: Variants | None = None,
    control_s: float = 0.02,
    engine: str | None = None,
    worlds: int = WORLDS,
    **scene_options: Unpack[SceneOptions],
) -> MjxEnv:
    """Return an environment of a run folder, a scene.json or a scene, for use with `jax.vmap`.

    Args:
        run: the folder, file or scene.
        task: a task, or a sentence such as "open the top drawer". It gives the initial state, the
            reward, and `success` and `progress` in the metrics of each state.
        without: objects that are left out.
        reward: function that JAX can trace, see `own_reward.Reward`; if None, the reward is that of
            the task, or 0.
        noise: noise that each reset adds to the scene; if None, no noise.
        variants: scenes of which each reset takes one, instead of noise; see `variants_of`.
        control_s: duration of each action [s].
        engine: native (C MuJoCo in threads), warp (MuJoCo Warp on NVIDIA GPUs) or mjx; if None, the
            fastest of the machine.
        worlds: largest number of worlds in a batch; only warp needs it.
        scene_options: gripper, robot, mount, control, drive_joints and colliders, as in
            `controlled_scene`. Without a mount, the robot stands where it reaches the task.

    Raises:
        SpecError: there is no scene, the handle does not exist, or there is nothing to actuate.
        EngineError: the engine cannot run here, or cannot simulate the scene.
    """
    name = engine or open_engine().name
    scene, todo = scene_of(run, task, without, scene_options)
    controlled = controlled_scene(scene, mjx=name == "mjx", **scene_options)
    return MjxEnv(
        controlled,
        task=None if todo is None else todo.on(controlled),
        reward=reward,
        noise=noise,
        variants=variants,
        engine=name,
        worlds=worlds,
        control_s=control_s,
    )

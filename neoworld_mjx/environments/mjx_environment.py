"""Environment of a scene for `jax.vmap`, with the interface of MuJoCo Playground.

The same pure functions run on C MuJoCo in threads (`engines`), MuJoCo Warp and MJX (`mjx_engines`).
"""

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float

from ..engines import ENGINES
from ..errors import EngineError, SpecError, choices
from ..physics.engine import open_engine
from ..spec import SceneSpec, read_scene
from .arm import SceneState, scene_state
from .controlled_scene import ControlledScene, SceneOptions, controlled_scene
from .engines import NativeSteps, StepEngine, initial_world
from .own_reward import Reward, traced_reward
from .randomization import ResetNoise, Variants, draw_start, scene_variants
from .reach import propose_mount
from .simplified_scene import scene_without
from .task import SceneTask, Task
from .task_words import task_of

WORLDS = 4096
"""Number of worlds for which warp allocates memory, unless stated."""


FASTEST, FARTHEST = 1e3, 1e3
"""Velocities [m/s or rad/s] and positions [m or rad] from which a simulation has diverged."""


class EnvState(eqx.Module):
    """State of one environment, with the field names of MuJoCo Playground."""

    data: SceneState
    obs: dict[str, Array] | Array
    """Observations by name, see `ControlledScene.observe`; of a policy, one vector."""
    reward: Float[Array, ""]
    done: Float[Array, ""]
    """1 if the simulation has diverged, otherwise 0."""
    metrics: dict[str, Array]
    """`success` (0 or 1) and `progress` (0 to 1) of the task, if there is one."""
    info: dict[str, Array]
    """`step`: number of steps since the last reset; `sample`: row of the variants; of a policy,
    `delay`: control steps after which an action acts, and `recent`: the latest actions, the last
    one first, shape [largest delay, action]."""


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
            state = scene_state(controlled.initial_data())
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
        qpos = draw_start(self.controlled, key, self._noise)
        return self._start(qpos, self.controlled.initial_ctrl, {})

    def reset_to(self, row: Array) -> EnvState:
        """Start an episode in one of the variants. JAX can trace this method."""
        if self._variants is None:
            raise SpecError("the environment has no variants")
        qpos, ctrl = (jnp.asarray(v)[row] for v in (self._variants.qpos, self._variants.ctrl))
        return self._start(qpos, ctrl, {"sample": row})

    def _start(self, qpos: Array, ctrl: Any, own: dict[str, Array]) -> EnvState:
        info = {"step": jnp.zeros((), jnp.int32), **own}
        start = initial_world(self.controlled.model, qpos, ctrl)
        world = self.steps.step(self._fields(info), start, jnp.asarray(start.ctrl), 0)
        return self._state(world, world, jnp.zeros(self.action_size), info)

    def step(self, state: EnvState, action: Float[Array, " action"]) -> EnvState:
        """Apply an action, clipped to its bounds, for one control interval.

        JAX can trace this method.
        """
        ctrl = self.controlled.controls(action, state.data, jnp)
        world = self.steps.step(self._fields(state.info), state.data, ctrl, self.n_substeps)
        info = state.info | {"step": state.info["step"] + 1}
        return self._state(world, state.data, action, info)

    def _fields(self, info: dict[str, Array]) -> dict[str, Array]:
        """Return the model fields in which this episode differs."""
        if self._variants is None:
            return {}
        return {k: jnp.asarray(v)[info["sample"]] for k, v in self._variants.fields.items()}

    def _state(
        self, world: SceneState, previous: SceneState, action: Array, info: dict[str, Array]
    ) -> EnvState:
        obs = self.controlled.observe(world, jnp)
        finite = jnp.all(jnp.abs(world.qvel) < FASTEST) & jnp.all(jnp.abs(world.qpos) < FARTHEST)
        for values in (world.xpos, world.xquat, world.qacc_warmstart):
            finite &= jnp.all(jnp.isfinite(values))
        numbers = {"reward": jnp.zeros(())}
        if self._reward is not None:
            numbers["reward"] = self._reward(obs, action, world, previous)
        if self.task is not None:
            numbers |= {"success": self.task.success(world), "progress": self.task.progress(world)}
        metrics = {k: jnp.where(finite, v, 0).astype(jnp.float32) for k, v in numbers.items()}
        done = 1.0 - finite.astype(jnp.float32)
        return EnvState(world, obs, metrics.pop("reward"), done, metrics, info)


def open_steps(controlled: ControlledScene, engine: str, worlds: int) -> StepEngine:
    """Return an engine for batches of at most `worlds` worlds.

    Raises:
        EngineError: the engine is unknown, cannot run here, or cannot simulate the scene.
    """
    model = copy.copy(controlled.model)
    # A `SceneState` has no values of sensors.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    if engine == "native":
        return NativeSteps(model)
    if engine not in ENGINES:
        raise EngineError(f"engine: {choices(engine, sorted(ENGINES))}")
    from ..physics.warp_engine import warp_device  # MJX takes seconds to import.
    from .mjx_engines import MjxSteps, WarpSteps, capacity

    if engine == "warp":
        warp_device()
        return WarpSteps(model, worlds, *capacity(controlled))
    return MjxSteps(model, controlled.initial_qpos)


def open_scene(
    run: Path | str | SceneSpec,
    task: Task | str | None,
    *,
    without: Sequence[str] = (),
    mjx: bool = False,
    links: bool = True,
    visual: bool = False,
    **scene_options: Unpack[SceneOptions],
) -> tuple[ControlledScene, SceneTask | None]:
    """Return a scene with actuators in its initial state, and the task in it.

    A robot without a mount stands where it reaches the task.
    """
    scene = scene_without(run if isinstance(run, SceneSpec) else read_scene(Path(run)), without)
    if task is not None:
        task = task_of(scene, task) if isinstance(task, str) else task
        scene, robot = task.scene, scene_options.get("robot")
        if robot is not None and scene_options.get("mount") is None:
            scene_options["mount"] = propose_mount(task, robot)
    controlled = controlled_scene(scene, mjx=mjx, links=links, visual=visual, **scene_options)
    return controlled, None if task is None else task.on(controlled)


def mjx_env(
    run: Path | str | SceneSpec,
    *,
    task: Task | str | None = None,
    without: Sequence[str] = (),
    reward: Reward | None = None,
    noise: ResetNoise | None = None,
    samples: int = 0,
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
        samples: number of draws that the photograph allows, of which each reset takes one, instead
            of noise; see `sample`.
        control_s: duration of each action [s].
        engine: native (C MuJoCo in threads), warp (MuJoCo Warp on NVIDIA GPUs) or mjx; if None, the
            fastest of the machine.
        worlds: largest number of worlds in a batch; only warp needs it.
        scene_options: gripper, robot, mount, control, drive_joints and colliders, as in
            `controlled_scene`. Without a mount, the robot stands where it reaches the task.

    Raises:
        SpecError: there is no scene, the handle does not exist, there is nothing to actuate, or no
            draw is kept.
        EngineError: the engine cannot run here, or cannot simulate the scene.
    """
    name = engine or open_engine().name
    controlled, in_scene = open_scene(
        run, task, without=without, mjx=name == "mjx", **scene_options
    )
    return MjxEnv(
        controlled,
        task=in_scene,
        reward=reward,
        noise=noise,
        variants=scene_variants(controlled, samples, seed=0),
        engine=name,
        worlds=worlds,
        control_s=control_s,
    )

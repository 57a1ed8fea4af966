"""Gymnasium environments of a scene, single and in batches, simulated by C MuJoCo."""

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Unpack

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import EngineError, SpecError, choices
from ..render.scene_images import scene_view
from ..spec import SceneSpec
from . import cameras
from .arm import copied, scene_state, settled_act
from .controlled_scene import ControlledScene, SceneOptions
from .mjx_environment import EnvState, mjx_env, open_scene
from .own_reward import Reward, with_four_arguments
from .randomization import ResetNoise, Variants, draw_start, scene_variants
from .task import SceneTask, Task

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError:
    raise EngineError(
        "gym_env needs the extra gym (gymnasium is missing): uv sync --inexact --extra gym"
    ) from None

Observation = dict[str, NDArray]
"""Observations by name, see `ControlledScene.observe`, and with `picture` the image of the
photograph's camera, shape [height, width, 3]."""


class SceneEnv(gymnasium.Env[Observation, NDArray]):
    """Environment whose actions are the drives' targets, followed by the gripper's seven targets.

    The reward is 0 if no `reward` function is given. An episode terminates only if the simulation
    diverges.
    """

    metadata = {"render_modes": ["rgb_array"]}

    def __init__(
        self,
        controlled: ControlledScene,
        *,
        reward: Reward | None,
        task: SceneTask | None,
        noise: ResetNoise,
        variants: Variants | None,
        picture: tuple[int, int] | None,
        control_s: float,
        horizon: int,
    ) -> None:
        self.controlled = controlled
        self.model = copy.copy(controlled.model)
        self.data = mujoco.MjData(self.model)
        self.render_mode = "rgb_array"
        self.metadata = {**type(self).metadata, "render_fps": round(1 / control_s)}
        self._task = task
        reward = task.reward if reward is None and task is not None else reward
        self._reward = None if reward is None else with_four_arguments(reward, controlled)
        self._noisy, self._variants, self._picture = noise != ResetNoise(), variants, picture
        if self._noisy and variants is not None:
            raise SpecError("an environment takes samples or noise, not both")
        self._draw = jax.jit(lambda key: draw_start(controlled, key, noise))
        self._substeps = max(round(control_s / self.model.opt.timestep), 1)
        self._horizon, self._steps = horizon, 0
        self._camera = controlled.scene.spec.camera
        # The declared types of Gymnasium are invariant.
        self.action_space, self.observation_space = _spaces(controlled, picture)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; the same seed gives the same initial state."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        qpos, ctrl = self.controlled.initial_qpos, self.controlled.initial_ctrl
        if self._noisy:
            qpos = self._draw(jax.random.key(int(self.np_random.integers(2**31))))
        if self._variants is not None:
            row = int(self.np_random.integers(len(self._variants)))
            qpos, ctrl = self._variants.qpos[row], self._variants.ctrl[row]
            self._camera = self._variants.cameras[row]
            for name, values in self._variants.fields.items():
                getattr(self.model, name)[:] = values[row]
        self.data.qpos[:], self.data.ctrl[:] = qpos, ctrl
        self.data.act[:] = settled_act(self.model, ctrl)
        mujoco.mj_forward(self.model, self.data)
        self._steps = 0
        return self._observe(), {}

    def step(self, action: NDArray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Apply an action, clipped to its bounds, for one control interval."""
        action = np.asarray(action, np.float32)
        previous = copied(scene_state(self.data))
        self.data.ctrl[:] = self.controlled.controls(action, previous)
        mujoco.mj_step(self.model, self.data, self._substeps)
        mujoco.mj_kinematics(self.model, self.data)  # Poses of bodies lag one time step behind.
        self._steps += 1
        # If the state is not finite, MuJoCo resets it and counts a warning.
        diverged = bool(self.data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number)
        diverged = diverged or not np.isfinite(self.data.qpos).all()
        observation, state = self._observe(), scene_state(self.data)
        reward = 0.0
        if self._reward is not None and not diverged:
            reward = float(self._reward(observation, action, state, previous))
        info: dict[str, Any] = {"diverged": diverged}
        if self._task is not None and not diverged:
            info["success"] = bool(self._task.success(state))
            info["progress"] = float(self._task.progress(state))
        return observation, reward, diverged, self._steps >= self._horizon, info

    def render(self) -> NDArray:
        """Return an image of the current state, with the robot, shape [height, width, 3]."""
        height, width = self._picture or (320, 480)
        spec = self.controlled.scene.spec.model_copy(update={"camera": self._camera})
        view = scene_view(spec, width=width, height=height)
        image = cameras.picture(self.controlled, self.data, view, width=width, height=height)
        return np.asarray(image.color)

    def _observe(self) -> Observation:
        result = self.controlled.observe(scene_state(self.data))
        if self._picture is not None:
            result["picture"] = self.render()
        return result


class SceneVectorEnv(VectorEnv[Observation, NDArray, NDArray]):
    """Batch of environments, which `gymnasium.make_vec` makes of `neoworld/Scene-v0`.

    A world that ended restarts in the next step, whose action it ignores (`NEXT_STEP`). With a
    task, infos have `success` and `progress`, and always `diverged`, each of shape [world].
    """

    def __init__(
        self,
        run: Path | str | SceneSpec,
        *,
        num_envs: int = 64,
        horizon: int | None = None,
        render_mode: str | None = None,
        engine: str = "native",
        **options: Any,
    ) -> None:
        """Open a scene.

        Args:
            run: a run folder, a scene.json or a scene.
            num_envs: number of worlds.
            horizon: number of steps after which an episode is truncated; if None, that of the task,
                or 500.
            render_mode: None; batches have no pictures.
            engine: native, which uses all cores, warp or mjx.
            options: task, without, reward, noise, samples, control_s, and the scene's, as in
                `mjx_env`. JAX traces the reward.

        Raises:
            SpecError: as `gym_env`, or a picture is asked for.
            EngineError: the engine cannot run here, or cannot simulate the scene.
        """
        if render_mode is not None or options.get("picture") is not None:
            raise SpecError('batches have no pictures: pass vectorization_mode="async" to make_vec')
        self.env = env = mjx_env(run, engine=engine, worlds=num_envs, **options)
        self.num_envs, self._horizon = num_envs, horizon or _horizon(env.task)
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}
        self.single_action_space, self.single_observation_space = _spaces(env.controlled, None)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._restart, self._advance = (jax.jit(jax.vmap(f)) for f in (env.reset, env.step))
        self._state: EnvState | None = None
        self._ended = np.ones(num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start all episodes; the same seed gives the same initial states."""
        super().reset(seed=seed)
        self._state = self._restart(self._keys())
        self._ended[:] = False
        return self._observed(), self._infos()

    def step(self, actions: NDArray) -> tuple[Observation, NDArray, NDArray, NDArray, dict]:
        """Apply actions, clipped to their bounds, for one control interval.

        Raises:
            SpecError: the environment was not reset.
        """
        if self._state is None:
            raise SpecError("reset the environment before its first step")
        after = self._advance(self._state, jnp.asarray(actions, jnp.float32))
        if self._ended.any():
            pick = lambda old, new: jnp.where(
                jnp.asarray(self._ended).reshape(-1, *[1] * (new.ndim - 1)), old, new
            )
            after = jax.tree.map(pick, self._restart(self._keys()), after)
        self._state = after
        reward = np.where(self._ended, 0.0, np.asarray(after.reward, float))
        terminated = np.asarray(after.done) > 0
        truncated = np.asarray(after.info["step"]) >= self._horizon
        self._ended = terminated | truncated
        return self._observed(), reward, terminated, truncated, self._infos()

    def _keys(self) -> jax.Array:
        return jax.random.split(jax.random.key(int(self.np_random.integers(2**31))), self.num_envs)

    def _observed(self) -> Observation:
        assert self._state is not None
        return jax.tree.map(np.array, self._state.obs)

    def _infos(self) -> dict[str, Any]:
        assert self._state is not None
        infos = {name: np.array(value) for name, value in self._state.metrics.items()}
        infos["diverged"] = np.asarray(self._state.done) > 0
        if "success" in infos:
            infos["success"] = infos["success"] > 0
        # Gymnasium marks the worlds for which an entry holds.
        return infos | {f"_{name}": np.ones(self.num_envs, bool) for name in infos}


def _spaces(controlled: ControlledScene, picture: tuple[int, int] | None) -> tuple[Any, Any]:
    """Return the spaces of actions and observations."""
    low, high = controlled.action_bounds
    start = controlled.observe(scene_state(controlled.initial_data()))
    observed: dict[str, spaces.Space[Any]] = {
        name: spaces.Box(-np.inf, np.inf, value.shape, np.float32) for name, value in start.items()
    }
    if picture is not None:
        observed["picture"] = spaces.Box(0, 255, (*picture, 3), np.uint8)
    return spaces.Box(low, high, dtype=np.float32), spaces.Dict(observed)


def gym_env(
    run: Path | str | SceneSpec,
    *,
    task: Task | str | None = None,
    without: Sequence[str] = (),
    reward: Reward | None = None,
    noise: ResetNoise | None = None,
    samples: int = 0,
    picture: tuple[int, int] | None = None,
    control_s: float = 0.02,
    horizon: int | None = None,
    render_mode: str | None = None,
    **scene_options: Unpack[SceneOptions],
) -> SceneEnv:
    """Return a Gymnasium environment of a run folder, a scene.json or a scene.

    `gymnasium.make("neoworld_mjx.environments:neoworld/Scene-v0", run=...)` takes the same.

    Args:
        run: the folder, file or scene.
        task: a task, or a sentence such as "open the top drawer". It gives the initial state, the
            reward, and `success` and `progress` in the info of each step.
        without: objects that are left out.
        reward: function of the observation, or of (obs, action, data, previous), see
            `own_reward.Reward`; if None, the reward is that of the task, or 0.
        noise: noise that each reset adds to the scene; if None, no noise.
        samples: number of draws that the photograph allows, of which each reset takes one with its
            camera, instead of noise; see `sample`.
        picture: height and width of the images in observations [px]; rendering an image takes about
            a second. If None, observations contain no image.
        control_s: duration of each action [s].
        horizon: number of steps after which an episode is truncated; if None, that of the task, or
            500.
        render_mode: rgb_array or None, as Gymnasium requires; `render` returns an image in either,
            of smooth surfaces if it is rgb_array or `picture` is given, else of colliders.
        scene_options: gripper, robot, mount, control, drive_joints and colliders, as in
            `controlled_scene`. Without a mount, the robot stands where it reaches the task.

    Raises:
        SpecError: there is no scene, the handle or the robot does not exist, there is nothing to
            actuate, the robot reaches the task from nowhere, or no draw is kept.
        EngineError: gymnasium is not installed.
    """
    if render_mode not in (None, "rgb_array"):
        raise SpecError(f"render_mode: {choices(render_mode, ['rgb_array'])}")
    # A flying gripper has no geoms but those that collide.
    visual = bool(picture or render_mode) and scene_options.get("gripper") is None
    controlled, in_scene = open_scene(run, task, without=without, visual=visual, **scene_options)
    return SceneEnv(
        controlled,
        reward=reward,
        task=in_scene,
        noise=noise or ResetNoise(),
        variants=scene_variants(controlled, samples, seed=0),
        picture=picture,
        control_s=control_s,
        horizon=horizon or _horizon(in_scene),
    )


def _horizon(task: SceneTask | None) -> int:
    return 500 if task is None else task.task.horizon

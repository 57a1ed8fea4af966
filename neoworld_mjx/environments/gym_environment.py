"""Gymnasium environment of a scene, simulated by C MuJoCo."""

import copy
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Unpack

import jax
import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import EngineError, SpecError, choices
from ..render.scene_images import scene_view
from ..spec import SceneSpec
from . import cameras
from .arm import copied, scene_state
from .controlled_scene import ControlledScene, ResetNoise, SceneOptions, controlled_scene
from .mjx_environment import scene_of, with_four_arguments
from .task import SceneTask, Task

try:
    import gymnasium
    from gymnasium import spaces
except ImportError:
    raise EngineError(
        "gym_env needs the extra gym (gymnasium is missing): uv sync --inexact --extra gym"
    ) from None

Observation = dict[str, NDArray]
"""Observations by name:

- poses [object, 7]: position [m] and quaternion (w, x, y, z) of each object's root body;
- joints, joint_velocities [joint]: joint positions [rad or m] and velocities [rad/s or m/s];
- gripper [8], if the scene has a gripper: pose of the tool, and distance between the pads [m];
- picture [height, width, 3], if images are requested.
"""
Reward = Callable[..., float]
"""Function of the observation, or of (observation, action, state, previous state)."""


class SceneEnv(gymnasium.Env[Observation, NDArray]):
    """Environment whose actions are the drives' targets, followed by the gripper's seven targets.

    The reward is 0 if no `reward` function is given. An episode terminates only if the simulation
    diverges.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(
        self,
        controlled: ControlledScene,
        *,
        reward: Reward | None,
        task: SceneTask | None,
        noise: ResetNoise,
        picture: tuple[int, int] | None,
        control_s: float,
        horizon: int,
    ) -> None:
        self.controlled = controlled
        self.model = copy.copy(controlled.model)
        self.data = mujoco.MjData(self.model)
        self.render_mode = "rgb_array"
        self._task = task
        reward = task.reward if reward is None and task is not None else reward
        self._reward = None if reward is None else with_four_arguments(reward)
        self._noise, self._picture = noise, picture
        self._substeps = max(round(control_s / self.model.opt.timestep), 1)
        self._horizon, self._steps = horizon, 0
        low, high = controlled.action_bounds
        self.action_space = spaces.Box(low, high, dtype=np.float32)
        start = scene_state(self.data)
        space: dict[str, spaces.Space[Any]] = {
            name: _unbounded(*value.shape) for name, value in controlled.observe(start).items()
        }
        if picture is not None:
            space["picture"] = spaces.Box(0, 255, (*picture, 3), np.uint8)
        # The declared type of Gymnasium is invariant.
        self.observation_space: Any = spaces.Dict(space)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; the same seed gives the same initial state."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        key = jax.random.key(int(self.np_random.integers(2**31)))
        start = self.controlled.initial_qpos
        if self._noise != ResetNoise():
            start, pos, quat = self.controlled.reset_state(key, self._noise)
            self.model.body_pos[:], self.model.body_quat[:] = pos, quat
        self.data.qpos[:] = start
        self.data.ctrl[:] = self.controlled.initial_ctrl
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
        view = scene_view(self.controlled.scene.spec, width=width, height=height)
        image = cameras.picture(self.controlled, self.data, view, width=width, height=height)
        return np.asarray(image.color)

    def _observe(self) -> Observation:
        result = self.controlled.observe(scene_state(self.data))
        if self._picture is not None:
            result["picture"] = self.render()
        return result


def _unbounded(*shape: int) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


def gym_env(
    run: Path | str | SceneSpec,
    *,
    task: Task | str | None = None,
    without: Sequence[str] = (),
    reward: Reward | None = None,
    noise: ResetNoise | None = None,
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
        reward: function of the observation, or of (observation, action, state, previous state); if
            None, the reward is that of the task, or 0.
        noise: noise that each reset adds to the scene; if None, no noise.
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
            actuate, or the robot reaches the task from nowhere.
        EngineError: gymnasium is not installed.
    """
    if render_mode not in (None, "rgb_array"):
        raise SpecError(f"render_mode: {choices(render_mode, ['rgb_array'])}")
    scene, task = scene_of(run, task, without, scene_options)
    # A flying gripper has no geoms but those that collide.
    visual = bool(picture or render_mode) and scene_options.get("gripper") is None
    controlled = controlled_scene(scene, visual=visual, **scene_options)
    return SceneEnv(
        controlled,
        reward=reward,
        task=None if task is None else task.on(controlled),
        noise=noise or ResetNoise(),
        picture=picture,
        control_s=control_s,
        horizon=horizon or (500 if task is None else task.horizon),
    )

"""A scene as an environment of LeRobot, and scripted demonstrations as a LeRobot data set.

`python lerobot_env_neoworld.py RUN_FOLDER DATA_SET` needs the extra gym and `lerobot[dataset]`.
"""

import sys
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Dict, flatten, flatten_space
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.envs.configs import EnvConfig

import neoworld_mjx as nw
from neoworld_mjx.environments.arm import scene_state

FPS, ID = 25, "neoworld_mjx.environments:neoworld/Scene-v0"


@EnvConfig.register_subclass("neoworld")
@dataclass
class NeoworldEnv(EnvConfig):
    """A task in a run folder, with the observations as one vector."""

    task: str = "open the top drawer"
    run: str = "out"
    robot: str = "panda"
    fps: int = FPS
    gym_kwargs = property(lambda self: {"run": self.run, "task": self.task, "robot": self.robot})

    def make(self):
        """Return one."""
        env = gym.make(ID, control_s=1 / FPS, samples=16, **self.gym_kwargs)
        space = env.observation_space
        flat = lambda obs: {"agent_pos": flatten(space, obs).astype(np.float32)}
        return gym.wrappers.TransformObservation(env, flat, Dict(agent_pos=flatten_space(space)))

    def create_envs(self, n_envs, use_async_envs=False):
        """Return the environments, by suite and task."""
        return {self.type: {0: gym.vector.SyncVectorEnv([self.make] * n_envs)}}


if __name__ == "__main__":
    own = NeoworldEnv(run=sys.argv[1])
    env, kind = own.make(), {"dtype": "float32", "names": None}
    scene, shape = env.unwrapped.controlled, env.observation_space["agent_pos"].shape
    features = {"observation.state": kind | {"shape": shape}, "action": kind | {"shape": (7,)}}
    data = LeRobotDataset.create("demo", FPS, features, sys.argv[2], use_videos=False)
    path = nw.reachable(nw.task_of(scene.scene.spec, own.task), own.robot, scene.arm.mount).path
    for seed in range(5):
        obs, _ = env.reset(seed=seed)
        for step, k in enumerate(np.repeat([0, 1, 1, *range(2, len(path))], 30)):
            state, grip = scene_state(env.unwrapped.data), 1 if step < 60 else -1
            a = np.float32(scene.arm.toward(state, *path[k], grip, limit=0.25))
            data.add_frame({"observation.state": obs["agent_pos"], "action": a, "task": own.task})
            obs, *_, info = env.step(a)
        data.save_episode() if info["success"] else data.clear_episode_buffer()
        print(f"episode {seed}: progress {info['progress']:.2f}, success {info['success']}")
    data.finalize()

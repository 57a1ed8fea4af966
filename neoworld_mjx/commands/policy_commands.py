"""Commands `train`, `evaluate` and `play`: policies of robots in a scene."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from .base_command import Command, CommandResult


@dataclass(frozen=True, kw_only=True)
class TrainCommand(Command):
    """Train a policy in a scene: a robot or a flying gripper that does a task.

    Every episode starts in another scene that the photograph allows. The folder gets the policy and
    the learning curve.
    """

    target: Positional[Path]
    """A run folder or a scene.json."""
    task: str
    """Kind and names, such as "open cabinet-drawer_top 0.8" or "place mug shelf"."""
    robot: str | None = None
    """panda, so101, ur5e or an MJCF file; without it a gripper flies."""
    mount: tuple[float, float, float, float] | None = None
    """Position [m] and yaw [rad] of the robot's base; proposed if not given."""
    out: Annotated[Path | None, arg(aliases=("-o",))] = None
    """Folder of the policy. Default: policy, in the run folder."""
    steps: int = 20_000_000
    """Control steps of all worlds."""
    minutes: float | None = None
    """Largest duration, without compiling."""
    worlds: int | None = None
    """Number of worlds. Default: 2048 on warp, 64 on native."""
    samples: int = 64
    """Draws of the scene in which episodes start; 0 for the scene itself."""
    seed: int = 0
    """Random seed."""
    without: tuple[str, ...] = ()
    """Objects that are left out, which is faster."""
    colliders: Literal["exact", "coarse"] = "exact"
    """Colliders in training; coarse ones are faster, and their error is printed."""
    engine: str | None = None
    """native, warp or mjx. Default: the fastest of the machine."""
    reward: str | None = None
    """Own reward as FILE.py:function, of (obs, action, data, previous) in jax.numpy; the file is
    executed. Default: the reward of the task."""
    horizon: int | None = None
    """Actions of an episode. Default: that of the task."""
    delay_steps: int = 0
    """Largest delay of actions [0.04 s], in training and evaluation; each episode has its own."""
    resume: bool = False
    """Continue the training of the policy in the folder."""

    def run(self) -> CommandResult:
        """Train."""
        from dataclasses import replace

        from ..environments.own_reward import read_reward
        from ..environments.robots import Mount
        from ..environments.training import (
            CURVE,
            POLICY,
            Training,
            default_options,
            propose_setting,
            train,
        )
        from ..errors import RunError
        from ..physics.engine import open_engine
        from ..spec import read_scene

        reward = None if self.reward is None else read_reward(self.reward)
        scene = read_scene(self.target)
        folder = self.target if self.target.is_dir() else self.target.parent
        out = self.out or folder / "policy"
        if not self.resume and (out / POLICY).exists():
            raise RunError(f"{out} has a policy: pass --resume, or name another folder with --out")
        engine = self.engine or open_engine().name
        options = default_options(engine)
        if self.worlds is not None:
            options = replace(options, worlds=self.worlds)
        training = Training(
            self.steps, self.minutes, self.samples, self.seed, engine, self.colliders
        )
        setting = propose_setting(
            scene,
            self.task,
            robot=self.robot,
            mount=None if self.mount is None else Mount(self.mount[:3], self.mount[3]),
            without=self.without,
            horizon=self.horizon,
            delay_steps=self.delay_steps,
        )
        policy = train(
            scene,
            setting,
            out,
            training=training,
            options=options,
            reward=reward,
            resume=self.resume,
        )
        last = (out / CURVE).read_text(encoding="utf-8").splitlines()[-1]
        return {
            "policy": str(out / POLICY),
            "steps": policy.about.steps,
            "engine": engine,
            "last": json.loads(last),
        }

    def lines(self, result: CommandResult) -> list[str]:
        """Return the steps and the file."""
        last = result["last"]
        return [
            f"trained for {result['steps']:,} control steps on {result['engine']}; of "
            f"{last['episodes']:,.0f} episodes that ended last, {last['success']:.0%} succeeded",
            f"wrote {result['policy']}",
            f"next: neoworld evaluate {result['policy']} {self.target}",
        ]


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(Command):
    """Run a policy in scenes that it has not seen, and count its successes.

    The scenes are draws of what the photograph allows, simulated by C MuJoCo.
    """

    policy: Positional[Path]
    """File policy.npz."""
    target: Positional[Path]
    """A run folder or a scene.json."""
    samples: int = 256
    """Number of draws; 0 for the scene itself."""
    seed: int = 0
    """Random seed; its draws are never those of training."""

    def run(self) -> CommandResult:
        """Evaluate."""
        from ..environments.policy import read_policy
        from ..environments.trials import evaluate

        outcome = evaluate(
            read_policy(self.policy), self.target, samples=self.samples, seed=self.seed
        )
        low, high = outcome.interval
        return {
            "verdict": outcome.phrase(),
            "rate": outcome.rate,
            "interval": [low, high],
            "successes": int(outcome.success.sum()),
            "n": len(outcome.success),
            "drawn": outcome.drawn,
            "progress": [round(float(p), 4) for p in outcome.progress],
        }

    def lines(self, result: CommandResult) -> list[str]:
        """Return the verdict."""
        return [result["verdict"]]


@dataclass(frozen=True, kw_only=True)
class PlayCommand(Command):
    """Write a video of a policy in a scene."""

    policy: Positional[Path]
    """File policy.npz."""
    target: Positional[Path]
    """A run folder or a scene.json."""
    out: Annotated[Path | None, arg(aliases=("-o",))] = None
    """File .webp or .gif. Default: policy.webp beside the policy."""
    azimuth: float | None = None
    """Direction from the scene to the camera about +z [deg]. Default: beside the robot."""

    def run(self) -> CommandResult:
        """Simulate and render."""
        from ..environments.policy import read_policy
        from ..environments.video import play

        path = self.out or self.policy.with_suffix(".webp")
        side = None if self.azimuth is None else math.radians(self.azimuth)
        done = play(read_policy(self.policy), self.target, path, azimuth=side)
        return {"video": str(path), "success": done}

    def lines(self, result: CommandResult) -> list[str]:
        """Return the file."""
        return [f"wrote {result['video']} (success: {'yes' if result['success'] else 'no'})"]

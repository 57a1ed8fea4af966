"""Commands `sample`, `train`, `evaluate` and `play`: draws of a scene, and policies in them."""

import json
import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, UseAppendAction, arg

from ..errors import RunError
from ..names import Format
from .base_command import Command, CommandResult, ConfiguredCommand


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
    """Largest duration, without drawing scenes and compiling; with --resume, in all."""
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
        from ..environments.policy import POLICY
        from ..environments.robots import Mount
        from ..environments.training import (
            CURVE,
            Training,
            check_folder,
            default_options,
            propose_setting,
            train,
        )
        from ..physics.engine import open_engine
        from ..spec import read_scene

        reward = None if self.reward is None else read_reward(self.reward)
        scene = read_scene(self.target)
        folder = self.target if self.target.is_dir() else self.target.parent
        out = self.out or folder / "policy"
        check_folder(out, self.resume, self.task, self.robot)
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
        mount = policy.about.setting.mount
        last = (out / CURVE).read_text(encoding="utf-8").splitlines()[-1]
        return {
            "policy": str(out / POLICY),
            "steps": policy.about.steps,
            "engine": engine,
            "mount": None if mount is None else [*mount.pos, mount.yaw],
            "last": json.loads(last),
        }

    def lines(self, result: CommandResult) -> list[str]:
        """Return the steps and the file."""
        last, mount = result["last"], result["mount"]
        stands = "the base of the robot stands at {:.2f} {:.2f} {:.2f}, turned by {:.2f} rad"
        return [
            *([] if mount is None else [stands.format(*mount)]),
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

    inputs: ClassVar = ("policy", "target")

    policy: Annotated[Positional[Path], arg(metavar="POLICY")]
    """File policy.npz."""
    target: Annotated[Positional[Path], arg(metavar="SCENE")]
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

    inputs: ClassVar = ("policy", "target")

    policy: Annotated[Positional[Path], arg(metavar="POLICY")]
    """File policy.npz."""
    target: Annotated[Positional[Path], arg(metavar="SCENE")]
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


SAMPLES = "samples.npz"


@dataclass(frozen=True, kw_only=True)
class SampleCommand(ConfiguredCommand):
    """Draw scenes that a photograph allows, and count in how many of them every object rests.

    Poses, sizes, openings and the camera are drawn from the uncertainty of the alignment;
    densities, frictions and losses of joints from priors. `samples.npz` next to the scene contains
    all draws.
    """

    target: Positional[Path]
    """A run folder or a scene.json."""
    n: Annotated[int, arg(aliases=("-n",))] = 64
    """Number of draws."""
    seed: int = 0
    """Random seed."""
    export: Path | None = None
    """New or empty folder to which each draw that is kept is written as a scene."""
    format: UseAppendAction[tuple[Format, ...]] = ()
    """With --export: format to write; repeatable. Default: mjcf."""

    def run(self) -> CommandResult:
        """Draw, settle and check."""
        from ..environments.samples import sample
        from ..export.formats import write_formats
        from ..io.files import write_output
        from ..run_folder import run_options
        from ..spec import read_scene

        folder = self.export
        if folder is not None and (folder.is_file() or (folder.is_dir() and any(folder.iterdir()))):
            raise RunError(f"{folder} is not an empty folder: name a new folder")
        config, scene = self.load_config(), read_scene(self.target)
        options = config.refine
        if (self.target / "run.json").is_file() and self.config is None and not self.set:
            options = run_options(self.target, {}).refine
        # Kernels of an accelerator compile for minutes, so they are used only if named.
        engine = options.rollout.engine
        engine = "native" if engine == "auto" else engine
        samples = sample(scene, self.n, seed=self.seed, options=options, engine=engine)
        file = (self.target if self.target.is_dir() else self.target.parent) / SAMPLES
        samples.write(file)
        if folder is not None:
            for k in samples.kept.tolist():
                drawn, out = samples.scene(k), folder / f"{k:04d}"
                write_formats(drawn, out, self.format or ("mjcf",))
                write_output(out / "scene.json", drawn.to_json(), RunError)
        result: CommandResult = {
            "target": str(self.target),
            "verdict": samples.phrase(),
            "draws": len(samples),
            "stand": int(samples.stands.sum()),
            "kept": len(samples.kept),
            "refused": dict(Counter(reason for reason in samples.reasons if reason)),
            "file": str(file),
        }
        if folder is not None:
            result["exported"] = str(folder)
        if all(item.uncertainty is None for item in scene.objects):
            result["note"] = "the scene was not aligned: only densities, frictions and losses vary"
        return result

    def lines(self, result: CommandResult) -> list[str]:
        """Return the verdict and the files."""
        lines = [result["verdict"], f"wrote {result['file']}"]
        lines += [f"wrote {result['exported']}"] if "exported" in result else []
        return lines + ([f"note: {result['note']}"] if "note" in result else [])

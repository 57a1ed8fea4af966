"""Training of a policy: the scenes, the optimization, and the files that it leaves."""

import dataclasses
import io
import json
import logging
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import ValidationError

from ..errors import SpecError
from ..io.files import content_hash, write_output
from ..io.text_files import validation_message
from ..physics.engine import open_engine
from ..progress import report, update
from ..spec import SceneSpec, read_scene
from . import ppo
from .mjx_environment import MjxEnv, open_scene
from .own_reward import Reward, reward_name
from .policy import ACTION_S, POLICY, About, Policy, Setting, read_policy
from .policy_environment import PolicyEnv, Script
from .randomization import Variants, scene_variants
from .reach import propose_mount, reachable
from .robots import Mount
from .scripted_motion import arm_script
from .simplified_scene import Colliders, scene_without
from .task import CONTROL_S, SceneTask
from .task_words import gripper_of, task_of

log = logging.getLogger(__name__)
TIMESTEP_S = 0.004
"""Time step of physics in training. Evaluation halves it."""
WRITE_S, REPORT_S = 60.0, 10.0
"""Intervals of writing the policy and of reporting progress [s]."""
CURVE, PICTURE = "curve.jsonl", "curve.png"
WORLDS = {"native": 64, "warp": 2048, "mjx": 256}
"""Default number of worlds by engine."""


@dataclass(frozen=True)
class Training:
    """Duration of training, and its scenes."""

    steps: int = 20_000_000
    """Control steps of all worlds."""
    minutes: float | None = None
    """Largest duration, without compiling."""
    samples: int = 64
    """Draws of the scene that the photograph allows; 0 trains in the scene itself."""
    seed: int = 0
    engine: str | None = None
    """native, warp or mjx; the fastest of the machine if None."""
    colliders: Colliders = "exact"
    """Coarse ones are faster; see `with_coarse_colliders`. Evaluation takes the exact ones."""
    snapshots: tuple[float, ...] = ()
    """Shares of the training after which the policy is also written, as policy-SHARE.npz."""


def propose_setting(
    scene: SceneSpec,
    task: str,
    *,
    robot: str | None = None,
    mount: Mount | None = None,
    without: tuple[str, ...] = (),
    horizon: int | None = None,
    delay_steps: int = 0,
) -> Setting:
    """Return a setting with a robot where it reaches the task, or a gripper at the task's handle.

    Args:
        scene: the scene.
        task: the task as a sentence.
        robot: a name or an MJCF file; if None, a gripper flies.
        mount: where the robot stands, if that is known.
        without: objects that are left out.
        horizon: actions of an episode; if None, as long as those of the task.
        delay_steps: largest delay of actions [control steps].

    Raises:
        SpecError: the scene has no such task, the robot reaches it from no place, the task has no
            handle for a gripper, or a number is not within its bounds.
    """
    if mount is not None and robot is None:
        raise SpecError("a mount is that of a robot: name the robot, too")
    named, gripper = task_of(scene_without(scene, without), task), None
    if robot is None:
        gripper = gripper_of(named)
    elif mount is None:
        mount = propose_mount(named, robot)
    if horizon is None:
        horizon = round(named.horizon * CONTROL_S / ACTION_S)
    try:
        return Setting(
            task=task, robot=robot, mount=mount, gripper=gripper, without=without, horizon=horizon,
            delay_steps=delay_steps,
        )  # fmt: skip
    except ValidationError as error:
        raise SpecError(validation_message(error, Setting)) from None


def task_scene(
    scene: SceneSpec,
    setting: Setting,
    *,
    mjx: bool = False,
    visual: bool = False,
    colliders: Colliders = "exact",
) -> SceneTask:
    """Return the task of a setting in a scene with the setting's robot or gripper.

    Raises:
        SpecError: the scene has no such task or handle, or the robot is not installed.
    """
    _, task = open_scene(
        scene,
        setting.task,
        without=setting.without,
        robot=setting.robot,
        mount=setting.mount,
        gripper=setting.gripper,
        links=False,
        mjx=mjx,
        visual=visual,
        colliders=colliders,
    )
    assert task is not None
    return task


def train(
    run: Path | str | SceneSpec,
    setting: Setting,
    out: Path,
    *,
    training: Training | None = None,
    options: ppo.PpoOptions | None = None,
    reward: Reward | None = None,
    resume: bool = False,
) -> Policy:
    """Train a policy and write it to a folder.

    The folder gets `policy.npz`, from which training can resume, `curve.jsonl` with one row for
    each update, and `curve.png` if Matplotlib is installed.

    Args:
        run: a run folder, a scene.json or a scene.
        setting: the task and what performs it.
        out: folder of the policy.
        training: duration, draws and seed.
        options: settings of the optimization; if None, defaults for the engine.
        reward: function that JAX can trace, see `own_reward.Reward`; if None, that of the task.
        resume: continue the training of the policy in the folder.

    Raises:
        SpecError: the task is not possible in the scene, the folder has a policy that is not to be
            resumed, or the policy is of another training.
        EngineError: the engine cannot run here or cannot simulate the scene.
    """
    t = training or Training()
    scene = run if isinstance(run, SceneSpec) else read_scene(Path(run))
    mjx = (t.engine or open_engine().name) == "mjx"
    task = task_scene(scene, setting, mjx=mjx, colliders=t.colliders)
    log.info("goal: %s", task.task.goal.meaning())
    for name, error in task.controlled.collider_errors.items():
        report(f"coarse colliders of {name} exceed the exact ones by {1000 * error:.0f} mm")
    variants = scene_variants(task.controlled, t.samples, t.seed)
    script = None
    if setting.robot is not None and setting.mount is not None:
        script = arm_script(task, setting.robot, setting.mount)
        if script is None:
            reach = reachable(task.task, setting.robot, setting.mount)
            log.warning(
                "from its mount, the arm does not follow the task (%s): no episode starts along a "
                "scripted motion",
                reach.reason,
            )
    return train_task(
        task, setting, out, variants=variants, script=script, training=t, options=options,
        reward=reward, resume=resume,
    )  # fmt: skip


def train_task(
    task: SceneTask,
    setting: Setting,
    out: Path,
    *,
    variants: Variants | None = None,
    script: Script | None = None,
    training: Training | None = None,
    options: ppo.PpoOptions | None = None,
    reward: Reward | None = None,
    resume: bool = False,
) -> Policy:
    """Train a policy of a task, as `train` does.

    Args:
        task: the task in a scene with a robot or a gripper, whose time step is set.
        setting: what is written in the policy; its timing counts.
        out: as for `train`.
        variants: scenes in which episodes start, instead of draws; if None, the scene itself.
        script: motion along which half of the episodes start.
        training: as for `train`.
        options: as for `train`.
        reward: as for `train`.
        resume: as for `train`.
    """
    t = training or Training()
    engine = t.engine or open_engine().name
    o = options or default_options(engine)
    check_folder(out, resume, setting.task, setting.robot)
    if t.steps < 1 or o.worlds < 1:
        raise SpecError(f"training: steps ({t.steps}) and worlds ({o.worlds}) must be positive")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SpecError(f"cannot write to {out}: {error.strerror}") from None
    task.controlled.model.opt.timestep = TIMESTEP_S
    env = MjxEnv(
        task.controlled,
        task=task,
        reward=reward,
        variants=variants,
        engine=engine,
        worlds=o.worlds,
        control_s=setting.control_s,
    )
    policy_env = PolicyEnv(env, setting.horizon, script, setting.delay_steps)
    about = About(
        setting=setting,
        scene=content_hash(task.task.scene.to_json()),
        seed=t.seed,
        steps=0,
        samples=t.samples,
        reward="" if reward is None else reward_name(reward)[:200],
        options=dataclasses.asdict(o),
    )
    a, b = jax.random.split(jax.random.key(t.seed))
    worlds, pool = ppo.open_worlds(policy_env, o, a)
    learner = jax.jit(partial(ppo.init, policy_env, o))(b, pool.obs)
    curve: list[dict[str, float]] = []
    if resume:
        learner, curve = _resumed(out, learner, about)
    advance = ppo.make_update(policy_env, o)
    snapshots = [s for s in sorted(t.snapshots) if not (out / snapshot_name(s)).exists()]
    before = curve[-1]["seconds"] if curve else 0.0
    if float(learner.steps) * 1000 >= t.steps:
        log.warning(
            "nothing to train: %s has had %d control steps", out, round(float(learner.steps) * 1000)
        )
    started = written = reported = -np.inf
    while float(learner.steps) * 1000 < t.steps:
        learner, worlds, averages = advance(learner, worlds, pool)
        row = {name: float(value) for name, value in averages.items()}
        if not np.isfinite(row["reward"]) or not np.isfinite(row["value_loss"]):
            raise SpecError("training diverged: its values are not finite; lower learning_rate")
        now = time.monotonic()
        if started == -np.inf:  # compiling does not count
            started = written = now
        seconds = before + now - started
        row = {"steps": round(float(learner.steps) * 1000), "seconds": round(seconds, 1), **row}
        curve.append(row)
        if now - reported > REPORT_S:
            _report(row, t)
            reported = now
        share = max(row["steps"] / t.steps, seconds / (60 * t.minutes) if t.minutes else 0.0)
        while snapshots and share >= snapshots[0]:
            policy_of(learner, about).write(out / snapshot_name(snapshots.pop(0)))
        if now - written > WRITE_S:
            _write(out, policy_of(learner, about), curve)
            written = now
        if t.minutes is not None and seconds > 60 * t.minutes:
            break
    policy = policy_of(learner, about)
    _write(out, policy, curve)
    draw_curve(curve, out / PICTURE)
    return policy


def check_folder(out: Path, resume: bool, task: str, robot: str | None) -> None:
    """Raise SpecError if a folder has a policy that would be lost, or one of another training.

    Args:
        out: the folder.
        resume: True if the training of the policy is to be resumed.
        task: the task as a sentence.
        robot: the robot; None for a flying gripper.
    """
    path = out / POLICY
    if not resume and path.exists():
        raise SpecError(f"{out} has a policy: resume it (--resume), or name another folder (--out)")
    if resume:
        was = read_policy(path).about.setting.model_dump()
        _check_same(path, was, {"task": task, "robot": robot})


def _check_same(path: Path, was: dict[str, Any], now: dict[str, Any]) -> None:
    other = [
        f"{k} is {was.get(k)!r}, not {value!r}" for k, value in now.items() if was.get(k) != value
    ]
    if other:
        raise SpecError(f"{path} is of another training, in which {'; '.join(other)}")


def snapshot_name(share: float) -> str:
    """Return the name of the file of a policy after a share of its training."""
    return f"policy-{share:g}.npz"


def _report(row: dict[str, float], training: Training) -> None:
    rate = row["steps"] / max(row["seconds"], 1e-9)
    update(done=row["steps"], of=training.steps, unit="steps", rate=rate)
    report(
        f"{row['seconds']:.0f} s, {row['steps']:,} control steps: success "
        f"{row['success']:.0%}, progress {row['progress']:.2f}, return {row['return']:.1f}"
    )


def default_options(engine: str) -> ppo.PpoOptions:
    """Return settings of the optimization that suit an engine."""
    if engine == "warp":
        return ppo.PpoOptions(worlds=WORLDS[engine])
    return ppo.PpoOptions(worlds=WORLDS[engine], unroll=32, minibatches=8, epochs=6)


def policy_of(learner: ppo.Learner, about: About) -> Policy:
    """Return the policy of a learner, in NumPy arrays."""
    own = about.model_copy(update={"steps": round(float(learner.steps) * 1000)})
    actor, normalizer = jax.tree.map(np.asarray, (learner.networks.actor, learner.normalizer))
    rest = tuple(np.asarray(leaf) for leaf in jax.tree.leaves(_rest(learner)))
    return Policy(own, actor, normalizer, rest)


def _rest(learner: ppo.Learner) -> tuple[Any, ...]:
    """Return what a learner has besides its policy."""
    key = jax.random.key_data(learner.key)
    return learner.networks.critic, learner.optimizer, key, learner.steps


def _resumed(
    out: Path, fresh: ppo.Learner, about: About
) -> tuple[ppo.Learner, list[dict[str, float]]]:
    """Return the learner and the curve of the training of a policy, like a fresh learner."""
    path = out / POLICY
    policy = read_policy(path)
    was, now = (
        {**a.setting.model_dump(), "reward": a.reward, **a.options} for a in (policy.about, about)
    )
    _check_same(path, was, now)
    leaves, tree = jax.tree.flatten((fresh.networks.actor, fresh.normalizer, _rest(fresh)))
    given = jax.tree.leaves((policy.actor, policy.normalizer, policy.rest))
    describe = lambda arrays: [(a.shape, a.dtype) for a in arrays]
    if describe(given) != describe(leaves):
        raise SpecError(
            f"{path} is of another training: the sizes of observations or networks are others"
        )
    actor, normalizer, (critic, optimizer, key, steps) = jax.tree.unflatten(
        tree, [jnp.asarray(leaf) for leaf in given]
    )
    learner = ppo.Learner(
        ppo.Networks(actor, critic), normalizer, optimizer, jax.random.wrap_key_data(key), steps
    )
    try:
        text = (out / CURVE).read_text(encoding="utf-8")
        curve = [json.loads(line) for line in text.splitlines()]
    except (OSError, ValueError):
        curve = []
    return learner, [row for row in curve if row["steps"] <= policy.about.steps]


def _write(out: Path, policy: Policy, curve: list[dict[str, float]]) -> None:
    policy.write(out / POLICY)
    rows = "".join(json.dumps(row) + "\n" for row in curve)
    write_output(out / CURVE, rows, SpecError)


def draw_curve(curve: list[dict[str, Any]], path: Path) -> None:
    """Draw success and return over steps, if Matplotlib is installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return
    figure = Figure(figsize=(6, 3.5), layout="constrained")
    axes = figure.add_subplot()
    ended = [row for row in curve if row["episodes"]]
    steps = [row["steps"] for row in ended]
    axes.plot(steps, [row["success"] for row in ended], label="success")
    axes.plot(steps, [row["progress"] for row in ended], label="progress")
    axes.set(xlabel="control steps", ylabel="share of episodes at their end", ylim=(0, 1.02))
    axes.legend()
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    write_output(path, buffer.getvalue(), SpecError)

"""Policies: optimization, files, evaluation and the command line."""

import dataclasses
import json
import re
import subprocess
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from scipy.stats import norm

import neoworld_mjx as nw
from neoworld_mjx.commands.policy_commands import TrainCommand
from neoworld_mjx.environments import policy_environment, ppo, training
from neoworld_mjx.environments.arm import scene_state
from neoworld_mjx.environments.mjx_environment import MjxEnv
from neoworld_mjx.environments.networks import LARGEST, Actor, Layer, Normalizer, flat, mlp
from neoworld_mjx.environments.own_reward import read_reward
from neoworld_mjx.environments.policy import Policy, Setting, read_policy
from neoworld_mjx.environments.policy_environment import PolicyEnv, Script, policy_action
from neoworld_mjx.environments.randomization import variants_of
from neoworld_mjx.environments.samples import sample
from neoworld_mjx.environments.task_words import gripper_of, task_of
from neoworld_mjx.environments.training import Training, propose_setting, task_scene, train
from neoworld_mjx.environments.trials import evaluate, wilson
from neoworld_mjx.environments.video import play
from neoworld_mjx.errors import SpecError

TASK = "open chest-drawer 0.5"
SMALL = ppo.PpoOptions(worlds=8, unroll=8, epochs=2, minibatches=2, actor=(16,), critic=(16,))


class Point(eqx.Module):
    """A point on a line that is rewarded near 1; some worlds diverge."""

    obs: jax.Array
    reward: jax.Array
    done: jax.Array
    metrics: dict[str, jax.Array]


class Line:
    """Moves a point by its actions; with `diverges` a world sometimes has no finite state."""

    action_size, horizon = 1, 20

    def __init__(self, diverges=False):
        self.diverges = diverges

    def reset(self, key):
        start = jax.random.uniform(key, (1,), minval=-1.0)
        return Point(start, jnp.zeros(()), jnp.zeros(()), {"success": jnp.zeros(())})

    def step(self, state, action):
        x = state.obs + 0.2 * jnp.clip(action, -1.0, 1.0)
        bad = self.diverges & (jnp.abs(x[0]) > 0.9)
        reward = jnp.where(bad, jnp.nan, -((x[0] - 1.0) ** 2))
        obs = jnp.where(bad, jnp.nan, x)
        return Point(
            flat({"x": obs}), jnp.nan_to_num(reward), bad * 1.0, {"success": (x[0] > 0.8) * 1.0}
        )


def optimized(env, updates, options):
    worlds, pool = ppo.open_worlds(env, options, jax.random.key(0))
    learner = ppo.init(env, options, jax.random.key(1), pool.obs)
    update = ppo.make_update(env, options)
    reports = []
    for _ in range(updates):
        learner, worlds, report = update(learner, worlds, pool)
        reports.append({k: float(v) for k, v in report.items()})
    assert update._cache_size() == 1  # compiled once
    return learner, reports


def test_the_optimization_learns_to_move_a_point():
    options = ppo.PpoOptions(worlds=64, unroll=20, actor=(32,), critic=(32,))
    _, reports = optimized(Line(), 25, options)
    assert reports[-1]["return"] > -8 > reports[0]["return"]
    assert reports[-1]["success"] > 0.9 > reports[0]["success"]


def test_worlds_that_diverge_leave_the_learner_finite_and_minibatches_need_not_divide_them():
    options = dataclasses.replace(SMALL, worlds=3, unroll=5, minibatches=4)
    learner, reports = optimized(Line(diverges=True), 10, options)
    assert sum(r["diverged"] for r in reports) > 0
    assert all(np.isfinite(r["value_loss"]) for r in reports)
    leaves = jax.tree.leaves((learner.networks, learner.normalizer))
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in leaves)


def test_a_gradient_that_is_not_finite_is_left_out():
    class Infinite(Line):
        def step(self, state, action):
            after = super().step(state, action)
            return eqx.tree_at(lambda s: s.reward, after, jnp.full((), jnp.inf))

    learner, reports = optimized(Infinite(), 2, SMALL)
    assert reports[-1]["left_out"] == 1.0
    assert all(bool(jnp.isfinite(v).all()) for v in jax.tree.leaves(learner.networks))


def test_an_episode_returns_what_it_was_rewarded():
    class Paid(Line):
        def step(self, state, action):
            after = super().step(state, action)
            return eqx.tree_at(lambda s: s.reward, after, jnp.full((), 0.25))

    # The first episodes are shorter: worlds start at different ages.
    _, reports = optimized(Paid(), 5, SMALL)
    assert reports[0]["return"] < 4
    assert reports[-1]["return"] == pytest.approx(0.25 * Line.horizon)


def test_an_update_that_goes_too_far_makes_no_further_steps():
    """The first step has no divergence; after a large one, all others have too much."""
    options = dataclasses.replace(SMALL, learning_rate=1e-3, kl=1e-9)
    _, (report,) = optimized(Line(), 1, options)
    assert report["left_out"] == pytest.approx(1 - 1 / (SMALL.epochs * SMALL.minibatches))
    _, (report,) = optimized(Line(), 1, dataclasses.replace(options, kl=1.0))
    assert report["left_out"] == 0


def test_the_density_of_actions_is_that_of_the_normal_distribution():
    rng = np.random.default_rng(0)
    mean, action, spread = rng.normal(size=(3, 4, 2))
    actor = Actor((), jnp.asarray(spread[0]))
    expected = norm.logpdf(action, mean, np.exp(spread[0])).sum(axis=1)
    given = ppo.log_prob(actor, jnp.asarray(mean), jnp.asarray(action))
    assert np.allclose(given, expected, rtol=1e-4)


def test_networks_have_finite_gradients_and_give_the_same_in_numpy():
    layers = (Layer(jnp.full((1, 2), -300.0), jnp.zeros(2)), Layer(jnp.ones((2, 1)), jnp.zeros(1)))
    assert np.isfinite(jax.grad(lambda x: mlp(layers, x)[0])(jnp.ones(1))).all()
    x = np.random.default_rng(0).normal(size=(5, 1)).astype(np.float32) / 300
    plain = jax.tree.map(np.asarray, layers)
    assert np.allclose(mlp(plain, x, np), mlp(layers, jnp.asarray(x)), atol=1e-5)
    swish = lambda v: v / (1 + np.exp(-v))
    assert np.allclose(mlp(plain, x, np), 2 * swish(-300 * x), atol=1e-4)


def test_the_normalizer_is_that_of_all_observations_at_once():
    x = np.random.default_rng(0).normal(3.0, 2.0, size=(200, 3)).astype(np.float32)
    x[:, 2] = 0.7
    n = Normalizer(jnp.zeros(()), jnp.zeros(3), jnp.zeros(3))
    for part in np.split(x, [7, 60]):
        n = n.update(jnp.asarray(part))
    assert np.allclose(n.mean, x.mean(axis=0), atol=1e-4)
    assert np.allclose(np.sqrt(n.squares / n.seen), x.std(axis=0), atol=1e-3)
    assert np.isfinite(n(jnp.full(3, 1e9))).all()
    wild = flat({"a": np.array([np.nan, np.inf, 1e30, 2.0])}, np)
    assert wild.tolist() == [0.0, 0.0, LARGEST, 2.0]


def test_wilson_intervals():
    # Values of Newcombe (1998), Table I, method 3.
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert wilson(1, 29) == pytest.approx((0.0061, 0.1718), abs=1e-4)


def test_variants_are_the_kept_draws(scene):
    controlled = task_scene(scene, Setting(task=TASK, gripper="chest-drawer_handle")).controlled
    drawn = sample(scene, 6, seed=1)
    variants = variants_of(controlled, drawn)
    assert len(variants) == len(drawn.kept) > 1
    damping = variants.fields["dof_damping"][:, controlled.model.joint("chest-slide").dofadr[0]]
    factor = np.asarray(drawn.poses.variation.joint_damping)[drawn.kept, 0]
    assert np.allclose(damping, 2.0 * factor, rtol=1e-5)
    mass = variants.fields["body_mass"][:, controlled.model.body("block").id]
    factor = np.asarray(drawn.poses.variation.mass)[drawn.kept, 1]
    assert np.allclose(mass, controlled.model.body("block").mass * factor, rtol=1e-5)
    # Derived fields follow: the inverse weight of a free body is 1 / mass.
    weight = variants.fields["body_invweight0"][:, controlled.model.body("block").id, 0]
    assert np.allclose(weight, 1 / mass, rtol=1e-4)
    env = MjxEnv(controlled, variants=variants, engine="native")
    states = jax.vmap(env.reset_to)(jnp.arange(2))
    assert np.allclose(states.data.qpos, variants.qpos[:2], atol=1e-6)


def test_a_flying_gripper_faces_the_handle_of_the_task(scene):
    assert gripper_of(task_of(scene, TASK)) == "chest-drawer_handle"
    with pytest.raises(SpecError, match=r"works on block and not on a handle.*--robot panda"):
        gripper_of(task_of(scene, "reach block"))


def test_settings_are_proposed_for_a_task(scene):
    setting = propose_setting(scene, TASK, delay_steps=2)
    assert setting.gripper == "chest-drawer_handle" and setting.horizon == 125
    mount = nw.Mount((0.9, 0.4, 0.0), -2.6)
    robot = propose_setting(scene, "reach block", robot="panda", mount=mount, horizon=7)
    assert (robot.mount, robot.gripper, robot.horizon) == (mount, None, 7)
    with pytest.raises(SpecError, match="name the robot, too"):
        propose_setting(scene, TASK, mount=mount)
    with pytest.raises(SpecError, match=r"delay_steps: .*100, got 101"):
        propose_setting(scene, TASK, delay_steps=101)


def test_a_flying_gripper_moves_by_changes_and_closes(scene):
    task = task_scene(scene, Setting(task=TASK, gripper="chest-drawer_handle"))
    inner = MjxEnv(task.controlled, task=task, engine="native", control_s=0.1)
    env = PolicyEnv(inner, 10)
    state = env.reset(jax.random.key(0))
    assert state.metrics["success"] == 0
    action = jnp.array([1.0, 0, 0, 0, 0, 0, -1.0])
    for _ in range(4):
        state = env.step(state, action)
    tool = np.asarray(task.controlled.tool(state.data)[0])
    start = np.array(task.controlled.gripper.pos)
    assert np.allclose(tool - start, [0.08, 0, 0], atol=0.01)
    assert float(inner.controlled.observe(state.data, jnp)["gripper"][-1]) < 0.02
    held = policy_action(task.controlled, state.data, np.full(7, 9.0), np)
    assert held[-1] == pytest.approx(0.12)


def test_a_policy_observes_the_joints_of_its_object_and_the_turn_of_its_target(scene):
    task = task_scene(scene, Setting(task=TASK, gripper="chest-drawer_handle"))
    controlled = task.controlled
    data = controlled.initial_data()
    data.qpos[controlled.model.joint("chest-slide").qposadr] = 0.123
    data.ctrl[3:6] = 0.21, 0.32, 0.43
    seen = policy_environment.policy_observation(task, scene_state(data), np)
    for value in (0.123, 0.21, 0.32, 0.43):
        assert np.isclose(seen, value, atol=1e-6).sum() == 1


def test_starts_along_a_script_have_done_its_first_steps(scene):
    task = task_scene(scene, Setting(task=TASK, gripper="chest-drawer_handle"))
    hold = jnp.asarray(task.controlled.hold_action)
    first = lambda state, start, t: jnp.where(t == 0, hold.at[0].add(0.02), hold)
    inner = MjxEnv(task.controlled, task=task, engine="native", control_s=0.04)
    env = PolicyEnv(inner, 10, Script(first, 2))
    states = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 16))
    assert {round(float(x), 6) for x in states.data.ctrl[:, 0]} == {0.0, 0.02}


def test_each_episode_delays_actions_by_its_own_steps(scene):
    task = task_scene(scene, Setting(task=TASK, gripper="chest-drawer_handle"))
    inner = MjxEnv(task.controlled, task=task, engine="native", control_s=0.04)
    env = PolicyEnv(inner, 10, delay_steps=2)
    states = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 16))
    assert set(states.info["delay"].tolist()) == {0, 1, 2}
    step, targets = jax.jit(jax.vmap(env.step)), []
    for k in range(5):
        action = jnp.zeros((16, 7)).at[:, 0].set(0.5 if k else 1.0).at[:, 6].set(1.0)
        states = step(states, action)
        targets.append(states.data.ctrl[:, 0])
    done = [0.0, 0.0, 0.02, 0.03, 0.04, 0.05, 0.06]  # of the third step with a delay of 2 on
    for delay, row in zip(states.info["delay"].tolist(), np.transpose(targets), strict=True):
        assert row == pytest.approx(done[2 - delay : 7 - delay], abs=1e-6)


@pytest.fixture(scope="module")
def trained(scene, tmp_path_factory):
    out = tmp_path_factory.mktemp("policy")
    setting = Setting(task=TASK, gripper="chest-drawer_handle", horizon=20)
    training = Training(steps=128, samples=4, engine="native")
    return out, setting, train(scene, setting, out, training=training, options=SMALL)


def test_training_writes_a_policy_and_resumes(scene, trained):
    out, setting, policy = trained
    assert policy.about.steps == 128 and policy.about.setting == setting
    rows = [json.loads(line) for line in (out / "curve.jsonl").read_text().splitlines()]
    assert [row["steps"] for row in rows] == [64, 128]
    more = Training(steps=256, samples=4, engine="native")
    resumed = train(scene, setting, out, training=more, options=SMALL, resume=True)
    rows = [json.loads(line) for line in (out / "curve.jsonl").read_text().splitlines()]
    assert [row["steps"] for row in rows] == [64, 128, 192, 256]
    assert resumed.about.steps == 256
    other = setting.model_copy(update={"horizon": 30})
    with pytest.raises(SpecError, match=r"another training, in which horizon is 20, not 30$"):
        train(scene, other, out, training=more, options=SMALL, resume=True)
    # Without an engine and options, those that suit the machine are used.
    with pytest.raises(SpecError, match=r"steps \(0\) and worlds \(\d+\) must be positive"):
        train(scene, setting, out / "new", training=Training(steps=0, samples=0))
    with pytest.raises(SpecError, match="has a policy: resume it"):
        train(scene, setting, out, training=more, options=SMALL)
    assert read_policy(out / "policy.npz").about.steps == 256


def test_the_curve_shows_success_and_progress(tmp_path):
    pytest.importorskip("matplotlib")
    rows = [{"steps": k, "episodes": 1, "success": 0.2, "progress": 0.4} for k in range(3)]
    for name in ("none", "success", "progress"):
        curve = [row | {name: 0.1 * row["steps"]} for row in rows]
        training.draw_curve(curve, tmp_path / f"{name}.png")
    assert len({file.read_bytes() for file in tmp_path.iterdir()}) == 3


def test_training_takes_a_reward_of_the_user(scene, tmp_path, neoworld):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "scene.json").write_text(scene.to_json())
    file = tmp_path / "mine.py"
    file.write_text(
        "import jax.numpy as jnp\n"
        "def still(obs, action, data, previous):\n"
        "    return 7.0 + 0 * jnp.sum(data.qpos - previous.qpos) + 0 * action[0]\n"
        "def eager(obs):\n    return float(obs['joints'][0])\n"
        "def many(obs):\n    return obs['joints'][:, None]\n"
        "def absent(obs):\n    return obs['joint'][0]\n"
        "def near(obs, action, data, previous, controlled):\n"
        "    return controlled.site(data, 'chest-drawer_handl', jnp)[0][0]\n"
    )
    small = ["--task", TASK, "--steps", 256, "--worlds", 8, "--samples", 0, "--engine", "native"]
    ended = neoworld("train", folder, *small, "--reward", f"{file}:still", "--json")
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["last"]["reward"] == pytest.approx(7.0, abs=1e-3)
    assert read_policy(folder / "policy" / "policy.npz").about.reward == "still"
    # A policy has its name, which nothing imports.
    ended = neoworld("train", folder, *small, "--resume")
    assert ended.returncode == 2 and "in which reward is 'still', not ''" in ended.stderr
    for name, message in {
        f"{file}:eager": "reward eager: JAX cannot trace it (ConcretizationTypeError",
        f"{file}:many": "reward many: returns shape (1, 1), not one number",
        f"{file}:absent": "reward absent: names of observations: got 'joint', valid are: poses",
        f"{file}:near": "did you mean 'chest-drawer_handle'?",
        f"{file}:missing": "has no function missing; it has: still, eager, many, absent, near",
        f"{tmp_path / 'none.py'}:f": "there is no file",
        "package.module:f": "is not of the form FILE.py:function",
    }.items():
        with pytest.raises(SpecError, match=re.escape(message)):
            train(scene, Setting(task=TASK, gripper="chest-drawer_handle"), tmp_path / "never",
                  training=Training(steps=1, samples=0, engine="native"), options=SMALL,
                  reward=read_reward(name))  # fmt: skip


def test_policies_are_evaluated_in_unseen_draws(scene, trained):
    _, _, policy = trained
    outcome = evaluate(policy, scene, samples=5)
    assert 0 < len(outcome.success) <= 5 and outcome.drawn == 5
    assert outcome.phrase().startswith(
        f"succeeds in 0 of {len(outcome.success)} scenes: 0% (0% to "
    )
    again = evaluate(policy, scene, samples=5)
    assert np.array_equal(outcome.progress, again.progress)


def test_videos_show_the_gripper_that_moves(scene, trained, tmp_path):
    learned = trained[2]
    *first, last = learned.actor.layers
    moving = learned.actor._replace(layers=(*first, last._replace(bias=np.ones(7, np.float32))))
    policy = Policy(learned.about, moving, learned.normalizer)
    with pytest.raises(SpecError, match=r"format: got '.mp4', valid are: .webp, .gif"):
        play(policy, scene, tmp_path / "v.mp4")
    assert play(policy, scene, tmp_path / "v.webp", size=(48, 64)) is False
    with Image.open(tmp_path / "v.webp") as video:
        assert video.size == (64, 48) and video.n_frames == 7
        assert np.asarray(video.convert("L")).std() > 5


def test_policy_files_keep_the_policy_and_refuse_strangers(scene, trained, tmp_path):
    _, _, policy = trained
    path = tmp_path / "policy.npz"
    policy.write(path)
    read = read_policy(path)
    obs = np.random.default_rng(0).normal(size=(3, policy.observation_size)).astype(np.float32)
    assert np.array_equal(read.act(obs), policy.act(obs)) and read.about == policy.about
    arrays = dict(np.load(path))

    class Evil:
        def __reduce__(self):
            return (subprocess.call, (["touch", str(tmp_path / "touched")],))

    def refused(changes, message, **more):
        np.savez(path, **(arrays | changes), **more)
        with pytest.raises(SpecError, match=message):
            read_policy(path)

    refused({"mean": np.array([Evil()], object)}, "holds Python objects")
    assert not (tmp_path / "touched").exists()
    refused({"mean": arrays["mean"][:-1]}, "shapes of its layers do not fit")
    refused({"bias_0": np.full_like(arrays["bias_0"], np.nan)}, "not a finite number")
    refused({"weight_1": arrays["weight_1"][:, :1]}, "shapes of its layers do not fit")
    refused({"about": np.array("{}")}, "it is not a policy file")
    refused({"about": np.array(1.0)}, "it is not a policy file")
    path.write_bytes(b"PK nothing")
    with pytest.raises(SpecError, match="no readable arrays"):
        read_policy(path)


def test_a_policy_of_another_scene_is_refused(scene, trained, tmp_path):
    policy = trained[2]
    wide = Policy(
        policy.about,
        policy.actor._replace(
            layers=(Layer(np.zeros((3, 7), np.float32), np.zeros(7, np.float32)),)
        ),
        Normalizer(np.ones((), np.float32), np.zeros(3, np.float32), np.ones(3, np.float32)),
    )
    with pytest.raises(SpecError, match="takes 3 observations and gives 7 actions; the scene has"):
        evaluate(wide, scene, samples=0)


def test_commands_train_and_evaluate(scene, trained, tmp_path, neoworld, caplog):
    file, out = tmp_path / "scene.json", tmp_path / "other"
    file.write_text(scene.to_json())
    small = ["--steps", 2, "--worlds", 8, "--samples", 0, "--engine", "native", "--horizon", 5]
    small += ["--without", "block", "--colliders", "coarse", "--delay-steps", 1, "--out", out]
    ended = neoworld("train", file, "--task", TASK, *small, "--json")
    assert ended.returncode == 0 and json.loads(ended.stdout)["steps"] == 8 * 32
    assert "256 control steps: success" in caplog.text
    policy = read_policy(out / "policy.npz")
    assert policy.about.setting.delay_steps == 1
    assert policy.about.setting.without == ("block",)
    assert policy.observation_size == trained[2].observation_size
    ended = neoworld("evaluate", out / "policy.npz", file, "--samples", 0, "--json")
    assert ended.returncode == 0 and json.loads(ended.stdout)["n"] == 1
    ended = neoworld("train", file, "--task", TASK, "--out", out)
    assert ended.returncode == 2 and "has a policy: resume it (--resume)" in ended.stderr


def test_training_with_a_robot_says_where_its_base_stands(scene, tmp_path, neoworld):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "scene.json").write_text(scene.to_json())
    arm = Path(__file__).parents[2] / "examples" / "arm" / "arm.xml"
    small = ("--steps", 128, "--worlds", 4, "--samples", 0, "--engine", "native")
    mount = ("--mount", -0.6, 0.1, 0.0, 0.3)
    command = ("train", folder, "--robot", arm, *mount, "--task", "reach block", *small)
    ended = neoworld(*command, "--json")
    assert ended.returncode == 0, ended.stderr
    result = json.loads(ended.stdout)
    assert result["mount"] == [-0.6, 0.1, 0.0, 0.3]
    said = TrainCommand(target=folder, task="reach block").lines(result)
    assert said[0] == "the base of the robot stands at -0.60 0.10 0.00, turned by 0.30 rad"

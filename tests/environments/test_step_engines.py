"""One environment on several engines, which agree with C MuJoCo."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import neoworld_mjx as nw
from neoworld_mjx.environments.arm import scene_state
from neoworld_mjx.environments.controlled_scene import controlled_scene
from neoworld_mjx.environments.engines import NativeSteps, initial_world
from neoworld_mjx.environments.mjx_engines import WarpSteps, capacity
from neoworld_mjx.environments.mjx_environment import open_steps
from neoworld_mjx.errors import EngineError, SpecError


def c_mujoco(controlled, qpos, actions, steps):
    """The reference: one MjData, and actions applied one after the other."""
    model, data = controlled.model, mujoco.MjData(controlled.model)
    data.qpos[:], data.ctrl[:] = qpos, controlled.initial_ctrl
    mujoco.mj_forward(model, data)
    for action in actions:
        data.ctrl[:] = controlled.controls(action, scene_state(data))
        mujoco.mj_step(model, data, steps)
    mujoco.mj_kinematics(model, data)
    return data


def roll(steps_engine, controlled, qpos, actions, steps):
    """The same in an engine, for worlds with different initial states [world, nq]."""
    world = jax.vmap(lambda q: initial_world(controlled.model, q, controlled.initial_ctrl))(
        jnp.asarray(qpos, jnp.float32)
    )
    look = jax.jit(jax.vmap(lambda w: steps_engine.step({}, w, w.ctrl, 0)))
    step = jax.jit(jax.vmap(lambda w, c: steps_engine.step({}, w, c, steps)))
    world = look(world)
    for action in actions:
        ctrl = jax.vmap(
            lambda w, a=action: controlled.controls(jnp.asarray(a), scene_state(w), jnp)
        )(world)
        world = step(world, ctrl)
    return world


def lifted(controlled, heights):
    """Initial states in which the block is lifted by heights."""
    qpos = np.tile(controlled.initial_qpos, (len(heights), 1))
    qpos[:, controlled.model.joint("block").qposadr[0] + 2] += heights
    return qpos


def open_engine(name, controlled):
    """Warp runs on its CPU backend here, which `open_steps` does not offer."""
    if name == "warp":
        pytest.importorskip("warp")
        return WarpSteps(controlled.model, 2, *capacity(controlled))
    return open_steps(controlled, name, 2)


ENGINES = [
    "native",
    pytest.param("mjx", marks=pytest.mark.slow),
    pytest.param("warp", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("name", ENGINES)
def test_engines_drop_a_block_and_pull_a_drawer_as_c_mujoco_does(scene, name):
    controlled = controlled_scene(scene, drive_joints=True, mjx=name == "mjx")
    model = controlled.model
    qpos = lifted(controlled, [0.5, 0.3])
    actions, steps = [np.array([0.12], np.float32)] * 10, 5
    world = roll(open_engine(name, controlled), controlled, qpos, actions, steps)
    for k in range(2):
        data = c_mujoco(controlled, qpos[k], actions, steps)
        block, slide = model.joint("block").qposadr[0], model.joint("chest-slide").qposadr[0]
        # The block falls freely for the whole time, and the drawer is on its way.
        assert 0.01 < qpos[k][block + 2] - data.qpos[block + 2] < 0.25
        assert 0.01 < data.qpos[slide] < 0.13
        assert np.allclose(world.qpos[k], data.qpos, atol=2e-4)
        assert np.allclose(world.xpos[k], data.xpos, atol=2e-4)
        assert np.allclose(np.abs(world.xquat[k]), np.abs(data.xquat), atol=2e-4)


def test_native_worlds_differ_by_their_fields_and_do_not_depend_on_threads(scene):
    controlled = controlled_scene(scene, drive_joints=True)
    model = controlled.model
    damping = np.tile(model.dof_damping, (2, 1)).astype(np.float32)
    damping[1, model.joint("chest-slide").dofadr[0]] *= 50
    outs = []
    for threads in (1, 2):
        engine = NativeSteps(model, threads)
        start = initial_world(model, controlled.initial_qpos, [0.15])
        step = jax.jit(
            jax.vmap(lambda d, e=engine, s=start: e.step({"dof_damping": d}, s, s.ctrl, 20))
        )
        outs.append(np.asarray(step(jnp.asarray(damping)).qpos))
    slide = model.joint("chest-slide").qposadr[0]
    assert np.array_equal(*outs)
    assert outs[0][0, slide] > 1.5 * outs[0][1, slide] > 0


def test_a_diverged_world_ends_and_leaves_the_others(scene):
    env = nw.mjx_env(scene, engine="native", reward=lambda obs: obs["joints"][0])
    state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 2))
    fast = state.data.qvel.at[1].set(1e12)
    state = eqx.tree_at(lambda s: s.data, state, state.data._replace(qvel=fast))
    after = jax.jit(jax.vmap(env.step))(state, jnp.full((2, 1), 0.1))
    assert after.done.tolist() == [0.0, 1.0]
    assert after.reward[1] == 0 and after.reward[0] > 0


def test_a_task_gives_reward_and_metrics(scene):
    env = nw.mjx_env(scene, task="open the drawer", engine="native", drive_joints=True,
                     gripper="chest-drawer_handle", control_s=0.5)  # fmt: skip
    first = env.reset(jax.random.key(0))
    assert first.metrics == {"success": 0, "progress": 0} and 0 < first.reward < 0.4
    opened = jnp.asarray(env.controlled.hold_action).at[0].set(0.2).at[1].set(0.2)
    last = env.step(env.step(first, opened), opened)
    assert last.metrics["success"] == 1 and last.metrics["progress"] == 1 and last.reward > 1


def test_rewards_take_one_or_four_arguments(scene):
    four = nw.mjx_env(
        scene,
        engine="native",
        reward=lambda obs, action, state, previous: state.qpos[0] - previous.qpos[0] + action[0],
    )
    state = four.step(four.reset(jax.random.key(0)), jnp.array([0.1]))
    assert float(state.reward) == pytest.approx(0.1 + float(state.data.qpos[0]), abs=1e-6)
    with pytest.raises(SpecError, match=r"reward: takes \(obs, action\)"):
        nw.mjx_env(scene, engine="native", reward=lambda obs, action: 0.0)


def test_unknown_engines_are_refused(scene):
    with pytest.raises(EngineError, match="valid are: mjx, native, warp"):
        nw.mjx_env(scene, engine="bullet")

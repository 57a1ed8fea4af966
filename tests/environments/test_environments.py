"""Environments of a scene with a drawer and a block: by Gymnasium, and under vmap."""

from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import neoworld_mjx as nw
from neoworld_mjx.environments.arm import SceneState, scene_state
from neoworld_mjx.environments.controlled_scene import controlled_scene
from neoworld_mjx.environments.flying_gripper import facing, handles
from neoworld_mjx.errors import SpecError
from neoworld_mjx.spec import Box, Camera, ObjectSpec, SceneObject, SceneSpec
from neoworld_mjx.spec.correlation import PoseCorrelation
from neoworld_mjx.spec.pose import from_yaw, rotate
from neoworld_mjx.spec.scene import PoseUncertainty
from tests.support.mechanisms import WOOD, geom, joint, part, single
from tests.support.notebooks import run_small

ARM = Path(__file__).parents[2] / "examples" / "arm" / "arm.xml"


@pytest.mark.filterwarnings("ignore:.*infinity.*:UserWarning")
def test_gymnasium_checks_pass_and_drives_reach_their_targets(scene):
    env = nw.gym_env(scene, reward=lambda obs: float(obs["joints"][0]), horizon=60)
    check_env(env, skip_render_check=True)
    assert isinstance(env, gymnasium.Env) and env.action_space.shape == (1,)
    first, _ = env.reset(seed=3)
    assert first["joints"] == pytest.approx([0.0], abs=1e-6)
    rewards = []
    for step in range(60):
        obs, reward, terminated, truncated, _ = env.step(np.array([0.15], np.float32))
        rewards.append(reward)
        assert not terminated and truncated == (step == 59)
    assert obs["joints"] == pytest.approx([0.15], abs=0.002)
    assert rewards[-1] == pytest.approx(0.15, abs=0.002)
    # What is out of bounds is held within them.
    env.reset(seed=3)
    for _ in range(80):
        obs, *_ = env.step(np.array([9.0], np.float32))
    assert obs["joints"][0] == pytest.approx(0.2, abs=0.005)
    env.close()


def test_noise_is_seeded_and_moves_only_movable_objects(scene):
    env = nw.gym_env(scene, noise=nw.ResetNoise(xy=0.02, yaw=0.3, joints=0.2))
    starts = [env.reset(seed=seed)[0] for seed in (1, 1, 2)]
    for name in ("poses", "joints"):
        assert np.array_equal(starts[0][name], starts[1][name])
    assert not np.allclose(starts[0]["poses"][1], starts[2]["poses"][1], atol=1e-4)
    assert np.allclose(starts[0]["poses"][0], starts[2]["poses"][0])
    assert all(0.0 <= start["joints"][0] <= 0.2 for start in starts)
    moved = np.abs(starts[2]["poses"][1, :2] - starts[0]["poses"][1, :2]).max()
    assert moved < 0.2
    # Nothing else moves than what is stated.
    exact, moved = (
        nw.gym_env(scene, noise=noise).reset(seed=1)[0] for noise in (None, nw.ResetNoise(xy=0.02))
    )
    assert np.abs(moved["poses"][1, :2] - exact["poses"][1, :2]).max() > 1e-3
    np.testing.assert_allclose(moved["poses"][:, 2:], exact["poses"][:, 2:], atol=1e-6)
    np.testing.assert_allclose(moved["joints"], exact["joints"], atol=1e-6)


def with_uncertain_chest(scene):
    """A fixed chest that the photograph shows to 2 cm and 0.05 rad, and a block known exactly."""
    exact = PoseUncertainty(along=0.0, across=0.0, yaw=0.0, log_scale=0.0)
    roughly = PoseUncertainty(along=0.02, across=0.02, yaw=0.05, log_scale=0.0)
    chest, block = scene.objects
    floor = single("floor", Box(size=(4.0, 4.0, 0.1)), 0.05)
    objects = (
        SceneObject(name="floor", spec=floor, environment=True, z=-0.1),
        chest.model_copy(
            update={
                "parent": "floor", "uncertainty": roughly, "xy": (1.0, 0.0), "z": 0.1,
                "joint_state": {"slide": 0.1},
            }
        ),
        block.model_copy(update={"uncertainty": exact}),
    )  # fmt: skip
    return scene.model_copy(update={"objects": objects})


def test_episodes_start_in_draws_that_the_photograph_allows(scene):
    env = nw.gym_env(with_uncertain_chest(scene), samples=8)
    starts = [env.reset(seed=seed)[0]["poses"] for seed in (0, *range(8))]
    assert np.array_equal(starts[0], starts[1])
    poses = np.array(starts)
    chest, block = env.controlled.names.index("chest"), env.controlled.names.index("block")
    assert 0.005 < poses[:, chest, 0].std() < 0.04
    offset = np.linalg.norm(poses[:, block, :2] - poses[:, chest, :2], axis=1)
    assert offset.std() < 2e-3  # the block moves with the chest
    moved, still = env.reset(seed=0)[0], env.step(env.controlled.hold_action)[0]
    np.testing.assert_allclose(still["poses"][chest], moved["poses"][chest], atol=1e-6)
    with pytest.raises(SpecError, match="samples or noise, not both"):
        nw.gym_env(with_uncertain_chest(scene), samples=2, noise=nw.ResetNoise(xy=0.1))


def test_jax_starts_in_the_same_draws(scene):
    single = nw.gym_env(with_uncertain_chest(scene), samples=4)
    env = nw.mjx_env(with_uncertain_chest(scene), samples=4)
    states = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 8))
    chest = np.asarray(states.obs["poses"])[:, env.controlled.names.index("chest")]
    assert chest[:, 0].std() > 0.005
    starts = np.array([single.reset(seed=k)[0]["poses"] for k in range(20)])
    starts = starts[:, env.controlled.names.index("chest")]
    assert (np.abs(chest[:, None] - starts).max(axis=2).min(axis=1) < 1e-5).all()


def test_a_gripper_opens_the_drawer_by_its_handle(scene):
    start = facing(scene, "chest-drawer_handle")
    out = rotate(np.array([np.cos(0.25), 0, 0, np.sin(0.25)]), np.array([1.0, 0, 0]))
    assert np.allclose(rotate(np.array(start.quat), np.array([0, 0, 1.0])), -out, atol=1e-6)
    # The bar is thinnest upwards.
    assert abs(rotate(np.array(start.quat), np.array([0, 1.0, 0]))[2]) > 0.99
    env = nw.gym_env(scene, gripper="chest-drawer_handle")
    obs, _ = env.reset(seed=0)
    assert obs["gripper"][:3] == pytest.approx(start.pos, abs=1e-6)
    action = env.controlled.hold_action.copy()
    plan = [(-0.1, 0.12)] * 40 + [(-0.1, 0.0)] * 20
    plan += [(x, 0.0) for x in np.linspace(-0.1, 0.05, 60)]
    for along, opening in plan:
        action[:3], action[6] = along * out, opening
        obs, *_ = env.step(action)
    assert 0.12 < obs["joints"][0] < 0.17


@pytest.mark.slow
def test_vmapped_environments_step(scene):
    env = nw.mjx_env(scene, reward=lambda obs: -jnp.abs(obs["joints"][0] - 0.1))
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 2))
    assert state.obs["poses"].shape == (2, 2, 7) and env.action_size == 1
    step = jax.jit(jax.vmap(env.step))
    targets = jnp.array([[0.1], [0.05]])
    for _ in range(30):
        state = step(state, targets)
    assert state.obs["joints"][:, 0] == pytest.approx([0.1, 0.05], abs=0.003)
    assert state.reward == pytest.approx([0.0, -0.05], abs=0.003)
    assert not state.done.any() and state.info["step"].tolist() == [30, 30]


@pytest.mark.slow
def test_the_policy_notebook_learns_on_a_simpler_drawer(scene):
    """The notebook's own cabinet compiles for 20 s; all else is as it stands."""
    chest = scene.object("chest").spec
    made = 'build(kind.program(kind.of_box((0.4, 0.4, 0.5)) | {"drawers": 2.0})).spec'
    ran = run_small("policy_rollouts_in_mjx", {made: "CHEST"}, CHEST=chest)
    assert ran["env"].controlled.joints == ("cabinet-slide",)
    assert ran["joints"].shape == (24, 50, 1)


def test_invalid_arguments_are_refused(scene):
    with pytest.raises(SpecError, match="did you mean 'chest-drawer_handle'"):
        nw.gym_env(scene, gripper="chest-drawer_handel")
    alone = SceneSpec(objects=(scene.object("block").model_copy(update={"parent": None}),))
    with pytest.raises(SpecError, match="no joints to drive"):
        controlled_scene(alone)
    named = SceneObject(name="end_effector", spec=alone.objects[0].spec)
    with pytest.raises(SpecError, match="which the gripper needs"):
        controlled_scene(SceneSpec(objects=(named,)), gripper=nw.Gripper((0, 0, 1)))


def test_rendered_images_show_the_current_state(scene):
    env = nw.gym_env(scene, picture=(24, 36))
    first, _ = env.reset(seed=0)
    assert env.observation_space.contains(first)
    for _ in range(20):
        obs, *_ = env.step(np.array([0.2], np.float32))
    assert np.abs(obs["picture"].astype(int) - first["picture"]).max() > 20


def test_rendered_images_show_the_robot(scene):
    camera = {"render_mode": "rgb_array", "picture": (24, 36)}
    alone = nw.gym_env(scene, **camera)
    beside = nw.gym_env(scene, robot=ARM, mount=nw.Mount((0.9, 0.4, 0.0), -2.6), **camera)
    images = [env.reset(seed=0)[0]["picture"].astype(int) for env in (alone, beside)]
    assert (np.abs(images[0] - images[1]).max(axis=2) > 20).sum() > 8


@pytest.mark.parametrize(("opening", "finger"), [(0.1, 0.05), (0.03, 0.015), (0.0, -0.02)])
def test_both_fingers_of_a_gripper_move_half_of_its_opening(scene, opening, finger):
    controlled = controlled_scene(scene, gripper=nw.Gripper((0, 0, 1), opening=0.08))
    assert controlled.initial_ctrl[-2:] == pytest.approx([0.04, 0.04])
    state = SceneState(*[np.zeros(0)] * 7)
    assert controlled.controls(controlled.hold_action, state)[-2:] == pytest.approx([0.04, 0.04])
    action = controlled.hold_action.copy()
    action[-1] = opening
    assert controlled.controls(action, state)[-2:] == pytest.approx([finger, finger])


def test_a_robot_and_a_task_in_gymnasium(scene):
    env = nw.gym_env(
        scene, robot=ARM, mount=nw.Mount((0.9, 0.4, 0.0), -2.6), task="open the drawer", horizon=5
    )
    first, _ = env.reset(seed=0)
    assert env.observation_space.contains(first) and env.action_space.shape == (7,)
    assert first["robot_joints"].shape == (5,)
    _, reward, _, _, info = env.step(np.array([0, 0, 0, 0, 0, 0, 1], np.float32))
    assert 0 < reward < 0.3 and info["progress"] == pytest.approx(0, abs=0.01)
    assert info["success"] is False
    own = nw.gym_env(
        scene,
        robot=ARM,
        mount=nw.Mount((0.9, 0.4, 0.0), -2.6),
        reward=lambda obs, action, state, previous: float(np.abs(state.qpos - previous.qpos).max()),
    )
    own.reset(seed=0)
    assert own.step(np.array([1, 0, 0, 0, 0, 0, 1], np.float32))[1] > 0


@pytest.mark.filterwarnings("ignore:.*(infinity|render mode).*:UserWarning")
def test_gymnasium_makes_a_scene_by_its_name(scene):
    env = gymnasium.make("neoworld_mjx.environments:neoworld/Scene-v0", run=scene, horizon=5)
    check_env(env.unwrapped)
    with pytest.raises(SpecError, match="render_mode: got 'human'"):
        gymnasium.make("neoworld/Scene-v0", run=scene, render_mode="human")


def test_gymnasium_makes_a_batch_of_worlds(scene):
    make = lambda **more: gymnasium.make_vec(
        "neoworld_mjx.environments:neoworld/Scene-v0", num_envs=3, run=scene, horizon=4, **more
    )
    hand = {"gripper": "chest-drawer_handle", "drive_joints": True}
    env = make(task="open the drawer", noise=nw.ResetNoise(joints=0.05), **hand)
    assert isinstance(env, gymnasium.vector.VectorEnv)
    env.action_space.seed(0)
    assert isinstance(env.metadata["autoreset_mode"], gymnasium.vector.AutoresetMode)
    starts = [env.reset(seed=seed)[0] for seed in (1, 1, 2)]
    assert env.observation_space.contains(starts[0])
    assert np.array_equal(starts[0]["joints"], starts[1]["joints"])
    assert not np.array_equal(starts[0]["joints"], starts[2]["joints"])
    assert len(set(starts[0]["joints"][:, 0].tolist())) == 3
    opened = np.tile(env.unwrapped.env.controlled.hold_action, (3, 1))
    opened[:, 0] = 0.2
    for step in range(4):
        obs, reward, terminated, truncated, info = env.step(opened)
        assert env.observation_space.contains(obs) and reward.shape == (3,)
        assert not terminated.any() and (truncated == (step == 3)).all()
    assert info["progress"].shape == (3,) and info["success"].dtype == bool
    last = obs["joints"]
    obs, reward, _, truncated, _ = env.step(opened)  # starts the next episodes
    assert (obs["joints"] < last).all() and not reward.any() and not truncated.any()
    obs, reward, *_ = env.step(opened)
    assert (reward > 0).all()
    # Worlds do as single environments do.
    single = gymnasium.make("neoworld/Scene-v0", run=scene, **hand)
    alone, batch = single.reset(seed=0)[0], make(**hand)
    together = batch.reset(seed=0)[0]
    for _ in range(3):
        alone, together = single.step(opened[0])[0], batch.step(opened)[0]
    for name, values in together.items():
        assert np.allclose(values, alone[name], atol=2e-4)
    wrapped = gymnasium.wrappers.vector.RecordEpisodeStatistics(make(**hand))
    wrapped.reset(seed=0)
    for _ in range(4):
        *_, info = wrapped.step(opened)
    assert info["episode"]["l"].tolist() == [4, 4, 4]
    with pytest.raises(SpecError, match="batches have no pictures"):
        make(picture=(24, 36))


def test_pictures_are_of_the_cameras_of_the_draws(scene):
    camera = Camera(fovy=0.8, height=0.9, pitch=0.5, width=36, height_px=24)
    uncertain = PoseCorrelation(camera=(0.02, 0.02, 0.05, 0.05))
    pictures = []
    for known in (PoseCorrelation(camera=(0.0,) * 4), uncertain):
        seen = scene.model_copy(update={"camera": camera, "correlation": known})
        env = nw.gym_env(seen, samples=4, picture=(24, 36))
        pictures += [env.reset(seed=seed)[0]["picture"] for seed in (1, 2, 3)]
    exact, moved = pictures[:3], pictures[3:]
    assert all(np.array_equal(exact[0], each) for each in exact)  # no object is uncertain
    assert sum(not np.array_equal(exact[0], each) for each in moved) > 1


def test_handles_have_poses_and_touch_sensors(scene):
    env = nw.gym_env(scene, drive_joints=True, gripper="chest-drawer_handle")
    env.reset(seed=0)
    # With pyramidal friction cones, what a gripper holds slips.
    assert env.model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    name, controlled = "chest-drawer_handle", env.controlled
    state = scene_state(env.data)
    pos, quat = controlled.site(state, name)
    tool = controlled.tool(state)
    assert np.linalg.norm(pos - tool[0]) == pytest.approx(0.1, abs=1e-6)  # 10 cm in front
    assert np.allclose(pos, env.data.site(name).xpos, atol=1e-9)
    traced = jax.jit(lambda x, q: controlled.site(state._replace(xpos=x, xquat=q), name, jnp))
    assert np.allclose(traced(state.xpos, state.xquat)[0], pos, atol=1e-5)
    assert np.allclose(np.abs(quat), np.abs(state.xquat[env.model.site_bodyid[0]]), atol=1e-6)
    assert env.data.sensor(f"{name}-touch").data[0] == 0
    with pytest.raises(SpecError, match=r"site: .*did you mean 'chest-drawer_handle'"):
        controlled.site(state, "chest-drawer_handel")


def test_objects_are_left_out_by_name(scene):
    env = nw.gym_env(
        scene, without=("block",), task="open the drawer", gripper="chest-drawer_handle"
    )
    assert env.controlled.names == ("chest",) and env.reset(seed=0)[0]["poses"].shape == (1, 7)
    assert controlled_scene(scene, without=("block",)).names == ("chest",)
    with pytest.raises(SpecError, match="did you mean 'block'"):
        nw.gym_env(scene, without=("blok",))
    with pytest.raises(SpecError, match="without chest: block stands on it"):
        nw.mjx_env(scene, without=("chest",))


def test_coarse_colliders_keep_mass_and_cavities_and_tell_their_error():
    ring = [
        geom(f"side{k}", Box(size=(0.02, 0.06, 0.1)), (0.1 * np.cos(a), 0.1 * np.sin(a), 0.05),
             quat=tuple(from_yaw(a).tolist()))
        for k, a in enumerate(np.arange(12) * np.pi / 6)
    ]  # fmt: skip
    floor = single("floor", Box(size=(4.0, 4.0, 0.1)), 0.05)
    pot = ObjectSpec(name="pot", materials=(WOOD,), parts=(part("pot", *ring),))
    scene = SceneSpec(
        objects=(
            SceneObject(name="floor", spec=floor, environment=True, z=-0.1),
            SceneObject(name="pot", spec=pot, parent="floor", z=0.1),
        )
    )
    hand = nw.Gripper((1, 1, 1))
    exact = controlled_scene(scene, gripper=hand)
    coarse = controlled_scene(scene, gripper=hand, colliders="coarse")
    assert exact.model.ngeom - coarse.model.ngeom == 12 - 8
    assert exact.collider_errors == {} and 0 < coarse.collider_errors["pot"] < 0.02
    own = [c.model.body("pot") for c in (exact, coarse)]
    assert own[0].mass == pytest.approx(own[1].mass)
    assert own[0].inertia == pytest.approx(own[1].inertia)
    # A ray from above through the middle of the pot meets the floor, not a hull.
    for c in (exact, coarse):
        data, hit = mujoco.MjData(c.model), np.zeros(1, np.int32)
        mujoco.mj_forward(c.model, data)
        distance = mujoco.mj_ray(c.model, data, [0, 0, 0.5], [0, 0, -1.0], None, 1, -1, hit)
        assert c.model.geom(hit[0]).name.startswith("floor") and distance > 0.45


def test_a_button_is_pressed_from_outside():
    """Its joint moves inward, unlike a drawer's."""
    parts = (
        part("body", geom("body", Box(size=(0.2, 0.2, 0.2)), (0, 0, 0.1))),
        part("button", geom("button", Box(size=(0.02, 0.03, 0.03)), (0.11, 0, 0.1))),
    )
    inward = joint("push", "prismatic", "body", "button", (0.11, 0, 0.1), (-1, 0, 0), upper=0.01)
    spec = ObjectSpec(name="box", materials=(WOOD,), parts=parts, joints=(inward,))
    scene = SceneSpec(objects=(SceneObject(name="box", spec=spec, environment=True),))
    (name,) = handles(scene)
    hand = facing(scene, name)
    assert rotate(hand.quat, (0.0, 0.0, 1.0)) == pytest.approx((-1, 0, 0), abs=1e-6)

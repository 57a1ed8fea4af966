"""Robot arms beside a scene: reading them, and moving their tools."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from neoworld_mjx.environments.arm import (
    DAMPING,
    LEASH_RAD,
    MOVE_M,
    POSTURE,
    TOWARD,
    TURN_RAD,
    scene_state,
)
from neoworld_mjx.environments.cameras import camera_view, picture
from neoworld_mjx.environments.controlled_scene import controlled_scene
from neoworld_mjx.environments.engines import initial_world
from neoworld_mjx.environments.robot_model import ONE_JAW_M
from neoworld_mjx.environments.robots import Mount, find_robot
from neoworld_mjx.errors import SpecError
from neoworld_mjx.physics.mjcf import VISUAL_GROUP
from neoworld_mjx.render.view import View
from neoworld_mjx.spec.pose import from_axis_angle, quat_mul, rotate
from tests.support import scenes

ARM = Path(__file__).parents[2] / "examples" / "arm" / "arm.xml"
MOUNT = Mount((-0.6, 0.2, 0.1), 0.5)


@pytest.fixture(scope="module")
def controlled():
    return controlled_scene(scenes.furnished(), robot=ARM, mount=MOUNT)


@pytest.fixture
def data(controlled):
    data = controlled.initial_data()
    return data


def act(controlled, data, action, steps):
    for _ in range(steps):
        data.ctrl[:] = controlled.controls(np.asarray(action), scene_state(data))
        mujoco.mj_step(controlled.model, data, 10)
    mujoco.mj_forward(controlled.model, data)


def test_the_jacobian_of_the_tool_is_that_of_mujoco(controlled, data):
    data.qpos[controlled.arm.qpos] += [0.3, -0.2, 0.1, 0.4, 0.7]
    mujoco.mj_forward(controlled.model, data)
    state, expected = scene_state(data), np.zeros((2, 3, controlled.model.nv))
    tool, _ = controlled.tool(state)
    np.testing.assert_allclose(tool, data.site("robot-tip").xpos, atol=1e-9)
    mujoco.mj_jac(controlled.model, data, *expected, tool, controlled.arm.tool_body)
    given = controlled.arm.jacobian(state).reshape(2, 3, -1)
    np.testing.assert_allclose(given, expected[..., controlled.arm.dof], atol=1e-9)


def test_the_tool_axes_are_those_of_the_free_gripper(controlled, data):
    """z points out of the palm, and the fingers close along y."""
    _, quat = controlled.tool(scene_state(data))
    apart = data.body("robot-left").xpos - data.body("robot-right").xpos
    out = data.site("robot-tip").xpos - data.body("robot-hand").xpos
    for axis, vector in (((0.0, 1.0, 0.0), apart), ((0.0, 0.0, 1.0), out)):
        assert abs(rotate(quat, np.array(axis)) @ vector) == pytest.approx(np.linalg.norm(vector))
    assert rotate(quat, np.array([0.0, 0.0, 1.0])) @ out > 0


def test_actions_move_the_tool_along_the_axes_of_the_base(controlled, data):
    act(controlled, data, [0, 0, 0, 0, 0, 0, 1], 20)
    start, _ = controlled.tool(scene_state(data))
    act(controlled, data, [0, 0, 0, 0, 0, 0, 1], 20)
    still, _ = controlled.tool(scene_state(data))
    np.testing.assert_allclose(still, start, atol=2e-4)
    act(controlled, data, [-0.25, 0, 0, 0, 0, 0, 1], 10)
    act(controlled, data, [0, 0, 0, 0, 0, 0, 1], 15)
    end, _ = controlled.tool(scene_state(data))
    moved = rotate(MOUNT.quat * [1, -1, -1, -1], end - start)
    assert moved == pytest.approx([-2.5 * MOVE_M, 0, 0], abs=0.1 * MOVE_M)


def test_the_gripper_opens_and_closes(controlled, data):
    assert controlled.observe(scene_state(data))["gripper"][7] == pytest.approx(1.0)
    act(controlled, data, [0, 0, 0, 0, 0, 0, -1], 40)
    assert controlled.observe(scene_state(data))["gripper"][7] == pytest.approx(0.0, abs=0.15)
    act(controlled, data, [0, 0, 0, 0, 0, 0, 0.5], 40)
    assert controlled.observe(scene_state(data))["gripper"][7] == pytest.approx(0.5, abs=0.05)


def test_controls_and_observations_are_traced_by_jax(controlled, data):
    state = scene_state(data)
    batch = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf, jnp.float32)] * 2), state)
    actions = jnp.array([[0.3, -0.5, 0.2, 0.1, 0.0, -0.2, -1.0], [0.0] * 6 + [1.0]])
    traced = jax.jit(jax.vmap(lambda a, s: controlled.controls(a, s, jnp)))(actions, batch)
    for given, action in zip(np.asarray(traced), np.asarray(actions), strict=True):
        np.testing.assert_allclose(given, controlled.controls(action, state), atol=1e-5)
    observed = jax.jit(jax.vmap(lambda s: controlled.observe(s, jnp)))(batch)
    for name, value in controlled.observe(state).items():
        np.testing.assert_allclose(observed[name][0], value, atol=1e-6)


def test_joint_targets(data):
    controlled = controlled_scene(scenes.furnished(), robot=ARM, mount=MOUNT, control="joints")
    assert controlled.arm is not None
    target = controlled.hold_action + np.array([0.2, 0.1, 0, 0, 0, 0], np.float32)
    act(controlled, data, target, 60)
    assert data.qpos[controlled.arm.qpos] == pytest.approx(target[:5], abs=0.01)


@pytest.fixture(scope="module")
def geared(tmp_path_factory):
    """An arm one of whose motors turns its joint by half of the control."""
    file = tmp_path_factory.mktemp("geared") / "arm.xml"
    motor = '<position class="arm" name="lift" joint="lift"'
    file.write_text(ARM.read_text().replace(motor, f'{motor} gear="2"'))
    return controlled_scene(scenes.furnished(), robot=file, mount=MOUNT)


def test_targets_are_positions_whatever_the_gear_of_a_motor(geared):
    data = geared.initial_data()
    home = np.array([0.0, -0.6, 1.6, 0.57, 0.0])
    lift = geared.model.actuator("robot-lift").id
    assert data.ctrl[lift] == pytest.approx(-1.2)
    before = geared.observe(scene_state(data))
    np.testing.assert_allclose(before["robot_joints"], home, atol=1e-9)
    np.testing.assert_allclose(before["robot_targets"], np.zeros(5), atol=1e-9)
    data.ctrl[lift] += 0.1
    data.qpos[geared.arm.qpos[0]] += 0.02
    data.qvel[geared.arm.dof] = [0.1, 0.2, 0.3, 0.4, 0.5]
    after = geared.observe(scene_state(data))
    np.testing.assert_allclose(after["robot_targets"], [-0.02, 0.05, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(after["robot_velocities"], [0.1, 0.2, 0.3, 0.4, 0.5])
    # The controls of no motion keep the targets.
    still = geared.controls(np.array([0, 0, 0, 0, 0, 0, 1.0]), scene_state(data))
    assert still[lift] == pytest.approx(-1.1)
    act(geared, data, [0, 0, 0, 0, 0, 0, 1], 60)
    assert geared.observe(scene_state(data))["robot_joints"][1] == pytest.approx(-0.55, abs=0.01)


def test_a_step_towards_a_pose_is_a_share_of_the_way_in_the_axes_of_the_base(controlled, data):
    state = scene_state(data)
    pos, quat = controlled.tool(state)
    base = np.array([0.01, -0.005, 0.004])
    turn = from_axis_angle(rotate(MOUNT.quat, np.array([0.0, 0.6, 0.8])), 0.05)
    for sign in (1.0, -1.0):  # Both quaternions are one orientation.
        action = controlled.arm.toward(
            state, pos + rotate(MOUNT.quat, base), sign * quat_mul(turn, quat), -0.5
        )
        np.testing.assert_allclose(action[:3], TOWARD * base / MOVE_M, atol=1e-9)
        expected = TOWARD * 0.05 / TURN_RAD * np.array([0, 0.6, 0.8])
        np.testing.assert_allclose(action[3:6], expected, atol=1e-9)
        assert action[6] == -0.5
    far = controlled.arm.toward(state, pos + rotate(MOUNT.quat, [5.0, 0, 0]), quat, 1, limit=0.4)
    np.testing.assert_allclose(far[:6], [0.4, 0, 0, 0, 0, 0], atol=1e-9)


@pytest.mark.parametrize("away", [0.0, 0.1])
def test_an_action_changes_the_targets_by_damped_least_squares(controlled, data, away):
    """About a small return to the initial posture; an angle of 1 rad weighs like 15 cm."""
    arm = controlled.arm
    state = scene_state(data)._replace(ctrl=data.ctrl + away * np.eye(7)[0])
    action = np.array([0.5, -0.3, 0.8, 0.2, -0.4, 0.1])
    targets = controlled.controls(np.append(action, 1.0), state)
    change = targets[arm.actuators] - state.ctrl[arm.actuators]
    twist = [rotate(MOUNT.quat, MOVE_M * action[:3]), rotate(MOUNT.quat, TURN_RAD * action[3:])]
    posture = -POSTURE * np.linalg.norm(action) * away * np.eye(5)[0]
    weights = np.array([1.0, 1.0, 1.0, 0.15, 0.15, 0.15])
    rows = np.vstack([weights[:, None] * arm.jacobian(state), DAMPING * np.eye(5)])
    right = np.append(weights * np.concatenate(twist), DAMPING * posture)
    expected = np.linalg.lstsq(rows, right, rcond=None)[0]
    np.testing.assert_allclose(change, expected, atol=1e-9)
    # Targets stay within reach of the positions, and within the joints' ranges.
    torn = state._replace(ctrl=data.ctrl + 5.0)
    held = controlled.controls(np.array([0, 0, 0, 0, 0, 0, 1.0]), torn)[arm.actuators]
    np.testing.assert_allclose(held, arm.home + LEASH_RAD)


def test_robots_that_cannot_be_used_are_refused(tmp_path):
    with pytest.raises(SpecError, match="did you mean 'panda'"):
        find_robot("pandas")
    with pytest.raises(SpecError, match="there is no file"):
        find_robot(tmp_path / "none.xml")
    bare = tmp_path / "arm.xml"
    bare.write_text(ARM.read_text().replace('<site name="tip" pos="0 0 0.07" size="0.006"/>', ""))
    with pytest.raises(SpecError, match="no site between the fingers"):
        controlled_scene(scenes.furnished(), robot=bare, mount=MOUNT)
    outside = tmp_path / "outside.xml"
    outside.write_text('<mujoco><asset><mesh file="../../etc/m.stl"/></asset></mujoco>')
    with pytest.raises(SpecError, match="outside"):
        controlled_scene(scenes.furnished(), robot=outside, mount=MOUNT)


def test_pictures_show_the_robot_from_the_wrist_and_from_any_view():
    shown = controlled_scene(scenes.furnished(), robot=ARM, mount=MOUNT, visual=True)
    data = mujoco.MjData(shown.model)
    data.qpos[:] = shown.initial_qpos
    mujoco.mj_kinematics(shown.model, data)
    view = View.look_at((-2.0, -1.0, 1.0), (-0.5, 0.2, 0.4), width=48, height=36)
    image = picture(shown, data, view, width=48, height=36)
    robot = image.names.index("robot-base")
    assert 20 < (image.segmentation == robot).sum() < 1000
    distance = np.linalg.norm(np.array(MOUNT.pos) - view.eye)
    assert np.median(image.depth[image.segmentation == robot]) == pytest.approx(distance, rel=0.3)
    wrist = camera_view(shown, data, "wrist", width=48, height=36)
    tool, quat = shown.tool(scene_state(data))
    np.testing.assert_allclose(wrist.axes[:, 2], rotate(quat, np.array([0.0, 0.0, 1.0])))
    assert np.linalg.norm(tool - wrist.eye) < 0.2
    camera = scenes.furnished().camera
    assert camera is not None
    np.testing.assert_allclose(camera_view(shown, data, "photo").eye, camera.position())


def test_a_gripper_may_have_one_jaw(tmp_path, controlled):
    """Its tool has the same axes, and is nearer to the jaw."""
    one = tmp_path / "arm.xml"
    text = re.sub(r'<(joint|position) [^>]*name="right"[^>]*>', "", ARM.read_text())
    one.write_text(text.replace(" 0.02 0.02", " 0.02"))
    other = controlled_scene(scenes.furnished(), robot=one, mount=MOUNT)
    (pos, quat), (pos_of_two, quat_of_two) = (
        c.tool(scene_state(c.initial_data())) for c in (other, controlled)
    )
    assert abs(quat @ quat_of_two) == pytest.approx(1.0)
    aside = pos - pos_of_two
    assert np.linalg.norm(aside) == pytest.approx(ONE_JAW_M)
    assert aside @ (controlled.initial_data().body("robot-left").xpos - pos_of_two) > 0


def test_pictures_show_the_visual_geoms_of_a_robot_that_has_some(tmp_path):
    """Not its colliders, of which only those of the gripper are kept."""
    ball = '<geom class="shown" type="sphere" size="0.05"/>'
    dressed, base = tmp_path / "arm.xml", '<body name="base" childclass="arm">'
    dressed.write_text(ARM.read_text().replace(base, base + ball, 1))
    mount = Mount((-0.6, 0.2, 0.0))  # without a stand
    model = controlled_scene(scenes.furnished(), robot=dressed, mount=mount, visual=True).model
    robot = [g for g in range(model.ngeom) if model.body(model.geom_bodyid[g]).name[:5] == "robot"]
    shown = [g for g in robot if model.geom_group[g] == VISUAL_GROUP]
    assert [model.geom_size[g, 0] for g in shown] == [0.05]
    assert len(robot) > 1 and model.geom_conaffinity[np.setdiff1d(robot, shown)].all()


def test_an_arm_stands_still_from_its_start_in_every_engine(controlled, data):
    """Its filters have settled, in MjData and in the worlds of a batch; a drawer is as it was."""
    assert data.joint("cabinet-slide").qpos == pytest.approx(0.2)
    assert data.act == pytest.approx(data.ctrl[controlled.arm.actuators], abs=1e-6)
    world = initial_world(controlled.model, controlled.initial_qpos, controlled.initial_ctrl)
    assert np.asarray(world.act) == pytest.approx(data.act, abs=1e-6)
    hold = controlled.hold_action
    for _ in range(10):
        data.ctrl[:] = controlled.controls(hold, scene_state(data))
        mujoco.mj_step(controlled.model, data, 10)
    moved = data.qpos[controlled.arm.qpos] - controlled.arm.home
    assert np.abs(moved).max() < 1e-3


def test_targets_of_an_arm_do_not_jump(controlled, data):
    """A jump of all targets reaches the actuators within 20 ms, and not at once."""
    arm, start = controlled.arm, data.ctrl.copy()
    data.ctrl[arm.actuators] += 0.05
    mujoco.mj_step(controlled.model, data)
    share = (data.act - start[arm.actuators]) / 0.05
    assert (share < 0.5).all() and (share > 0.2).all()
    mujoco.mj_step(controlled.model, data, 9)
    assert data.act == pytest.approx(data.ctrl[arm.actuators], abs=2e-3)


def test_a_stand_fills_pictures_below_a_base_and_touches_nothing():
    high = Mount((0.3, -0.35, 0.3), 0.5)
    shown = controlled_scene(scenes.furnished(), robot=ARM, mount=high, visual=True).model
    stand = shown.geom("robot-stand")
    low, top = stand.pos[2] - stand.size[2], stand.pos[2] + stand.size[2]
    assert (low, top) == (pytest.approx(0.0), pytest.approx(0.3))
    assert not stand.contype[0] and not stand.conaffinity[0]
    simulated = controlled_scene(scenes.furnished(), robot=ARM, mount=high).model
    assert "robot-stand" not in [simulated.geom(g).name for g in range(simulated.ngeom)]


def test_a_robot_with_a_name_is_found_in_a_checkout_of_menagerie(tmp_path, monkeypatch):
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    file = tmp_path / "franka_emika_panda" / "mjx_panda.xml"
    file.parent.mkdir()
    file.write_text("<mujoco/>")
    found = find_robot("panda")
    assert found.file == file and found.trusted and len(found.home) == 7
    assert find_robot(found) is found

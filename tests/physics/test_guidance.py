"""Springs of guided settling: motions compared with solutions of the equation of motion."""

import mujoco
import numpy as np
import pytest

from neoworld_mjx.physics.colliders import start_state
from neoworld_mjx.physics.guidance import (
    Guidance,
    GuidedBodies,
    free_bodies,
    guided_bodies,
    limit_speed,
    springs,
)
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.spec import SceneObject, SceneSpec
from neoworld_mjx.spec.pose import angle_between, from_axis_angle, quat_mul
from tests.support import scenes
from tests.support.scenes import compile_scene

RATE, STEP = 12.0, 5e-4
NEVER_FADES = Guidance(rate=RATE, fade_s=1e9, max_speed=1e9)


def floating(gravity=(0.0, 0.0, 0.0)):
    """A cabinet in the air, whose center of mass is not at its origin and whose joints are free."""
    item = SceneObject(
        name="cabinet", spec=scenes.cabinet(), z=2.0, yaw=0.7, joint_state={"slide": 0.2}
    )
    model, data = start_state(SceneSpec(objects=(item,), gravity=gravity), STEP)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.dof_damping[6:] = 1e6  # the joints stay
    return model, data


def released(data, model, guidance, seconds):
    """Move under springs to the start pose; return the times and the coordinates."""
    bodies = free_bodies(model, model.key("start").qpos)
    hold = GuidedBodies(bodies, springs(bodies, model.key("start").qpos[bodies.qpos]))
    times, states = [], []
    for _ in range(round(seconds / STEP)):
        data.qfrc_applied[:], data.qvel[:] = hold.push(guidance, data.time, data.qpos, data.qvel)
        mujoco.mj_step(model, data)
        times.append(data.time)
        states.append(data.qpos[:7].copy())
    return np.array(times), np.array(states)


def test_a_displaced_object_returns_critically_damped():
    model, data = floating()
    start, offset = data.qpos[:3].copy(), np.array([0.03, -0.02, 0.01])
    data.qpos[:3] += offset
    times, states = released(data, model, NEVER_FADES, 0.4)
    share = np.exp(-RATE * times) * (1 + RATE * times)
    np.testing.assert_allclose(states[:, :3] - start, share[:, None] * offset, atol=1e-4)
    turned = angle_between(
        states[:, 3:], np.broadcast_to(model.key("start").qpos[3:7], (len(states), 4))
    )
    # A force that does not act at the center of mass would rotate it.
    assert turned.max() < np.radians(0.02)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0, 1), (1, 2, -1)])
def test_a_turned_object_returns_critically_damped_about_its_center_of_mass(axis):
    model, data = floating()
    bodies = free_bodies(model, data.qpos)
    mujoco.mj_forward(model, data)
    center = data.subtree_com[1].copy()
    angle = 0.05
    turn = np.array(from_axis_angle(axis, angle))
    there = np.zeros(9)
    mujoco.mju_quat2Mat(there, turn)
    data.qpos[:3] = center + there.reshape(3, 3) @ (data.qpos[:3] - center)
    data.qpos[3:7] = quat_mul(turn, data.qpos[3:7])
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.subtree_com[1], center, atol=1e-12)
    assert np.linalg.norm(bodies.center) > 0.01
    times, states = released(data, model, NEVER_FADES, 0.4)
    share = np.exp(-RATE * times) * (1 + RATE * times)
    start = np.broadcast_to(model.key("start").qpos[3:7], (len(states), 4))
    # Small angles: gyroscopic torques are of second order.
    np.testing.assert_allclose(angle_between(states[:, 3:], start), share * angle, atol=6e-4)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.subtree_com[1], center, atol=1e-4)


def test_an_object_sags_by_gravity_over_the_squared_rate():
    model, data = floating(gravity=(0.0, 0.0, -9.81))
    start = data.qpos[:3].copy()
    _, states = released(data, model, NEVER_FADES, 1.5)
    np.testing.assert_allclose(states[-1, :3] - start, [0, 0, -9.81 / RATE**2], atol=2e-5)


def test_the_speed_is_limited_and_its_direction_kept():
    qvel = np.array([[[3.0, 0.0, -4.0, 9.0, 8.0, 7.0], [0.1, 0.2, 0.3, 0.0, 0.0, 50.0]]])
    slow = limit_speed(qvel, 2.0)
    np.testing.assert_allclose(slow[0, 0], np.array([3.0, 0.0, -4.0, 9.0, 8.0, 7.0]) * 2 / 5)
    np.testing.assert_array_equal(slow[0, 1], qvel[0, 1])
    model, data = floating(gravity=(0.0, 0.0, -9.81))
    data.qvel[:3] = [0.0, 30.0, 0.0]
    free = Guidance(rate=0.0, fade_s=1.0, max_speed=1.5)
    _, states = released(data, model, free, 0.5)
    speed = np.linalg.norm(np.diff(states[:, :3], axis=0), axis=1) / STEP
    # A step under gravity follows the limit.
    assert 1.49 < speed.max() < 1.5 + 9.81 * STEP


def test_scaled_candidates_have_the_masses_and_centers_of_their_models():
    scene = compile_scene(scenes.lamp(), samples=16)
    logs = np.tile(np.float32([[-0.2], [0.0], [0.3]]), (1, len(scene.names)))
    layouts = Layout.zero(3, len(scene.names))
    poses = scene.place_exactly(Layout(layouts.xy, layouts.yaw, logs * np.asarray(scene.optimised)))
    found = guided_bodies(scene, poses, np)
    for k in range(3):
        model, data = start_state(scene.apply(Layout(layouts.xy, layouts.yaw, logs), k))
        exact = free_bodies(model, data.qpos)
        np.testing.assert_allclose(found.springs.mass[k], exact.mass, rtol=1e-6)
        np.testing.assert_allclose(found.springs.center[k], exact.center, atol=1e-7)
        np.testing.assert_allclose(found.springs.inertia[k], exact.inertia, rtol=2e-6, atol=1e-12)

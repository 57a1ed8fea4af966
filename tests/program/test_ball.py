"""Ball joints from the program to every format, and through the physics."""

import mujoco
import numpy as np
import pytest

from neoworld_mjx.export import export_object, import_file
from neoworld_mjx.physics.mjcf import START, to_mjspec
from neoworld_mjx.program import build
from neoworld_mjx.spec import SceneObject, SceneSpec, link_poses
from neoworld_mjx.spec.pose import angle_between, from_axis_angle, rotate

LAMP = """
from neoworld_mjx.program.sdk import Object, cylinder, frustum, sphere
lamp = Object("lamp")
foot = lamp.part("foot", material="steel")
foot.add(cylinder(0.06, 0.02), by="bottom")
foot.add(cylinder(0.006, 0.3), at=(0, 0, 0.02), by="bottom")
head = lamp.part("head", material="plastic")
knuckle = head.add(sphere(0.012), at=(0, 0, 0.32), by="bottom")
head.add(frustum(0.01, 0.04, 0.08), at=(0, 0, 0.34), by="bottom")
lamp.ball("neck", foot, head, at=knuckle.anchor("centre"), swing={swing})
"""
STATE = {"neck.x": 0.2, "neck.y": -0.3, "neck.z": 0.4}


@pytest.fixture(scope="module")
def lamp():
    built = build(LAMP.format(swing=0.3))
    assert built.spec is not None and not built.signals, [s.phrase() for s in built.signals]
    return built.spec


def test_a_ball_joint_turns_by_a_rotation_vector(lamp):
    moved = link_poses(lamp, STATE)["head"]
    vector = np.array(list(STATE.values()))
    turn = from_axis_angle(vector, float(np.linalg.norm(vector)))
    assert angle_between(moved.quat, turn) < 1e-9
    assert np.allclose(moved.apply([0, 0, 0.332]), [0, 0, 0.332])
    assert link_poses(lamp, {})["head"].quat[0] == 1


def test_a_ball_joint_is_three_hinges_through_one_point_in_urdf(lamp, tmp_path):
    export_object(lamp, tmp_path)
    made, was = import_file(tmp_path / "object.urdf").spec, lamp.joints[0]
    assert [joint.name for joint in made.joints] == ["neck_x", "neck_y", "neck_z"]
    for joint, axis in zip(made.joints, np.eye(3), strict=True):
        assert (joint.type, joint.damping, joint.friction) == (
            "revolute", pytest.approx(was.damping), pytest.approx(was.friction)
        )  # fmt: skip
        assert np.allclose(joint.axis, axis) and np.allclose(joint.pos, was.pos, atol=1e-6)
        assert (joint.lower, joint.upper) == pytest.approx((-0.3, 0.3))


def test_physics_begins_where_the_state_says_and_stays_in_the_cone(lamp):
    item = SceneObject(name="lamp", spec=lamp, fixed_base=True, joint_state={"neck.x": 0.2})
    model = to_mjspec(SceneSpec(objects=(item,))).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = model.key(START).qpos
    mujoco.mj_kinematics(model, data)
    want = link_poses(lamp, item.joint_state)["head"].apply([0, 0, 0.4])
    head = data.body("lamp-head")
    assert np.allclose(head.xpos + rotate(head.xquat, [0, 0, 0.068]), want, atol=1e-9)
    model.opt.gravity[:] = (9, 3, -3)
    for _ in range(2000):
        mujoco.mj_step(model, data)
    angle = 2 * np.arccos(np.clip(abs(data.joint("lamp-neck").qpos[0]), 0, 1))
    assert 0.2 < angle < 0.33

"""Penetration, drift and tilt of a scene, and the bounds that decide."""

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.measure import measured
from neoworld_mjx.physics import rest
from neoworld_mjx.physics.colliders import snap_exactly
from neoworld_mjx.spec import HollowBox, SceneObject, Sphere
from neoworld_mjx.spec.pose import quat_mul
from tests.support import scenes


def box(name, size=(0.1, 0.1, 0.1)):
    return scenes.block(name, size)


@pytest.mark.parametrize("depth", [0.0004, 0.0009, 0.0011, 0.0019, 0.03])
def test_depth_of_two_boxes_side_by_side(depth):
    result = measured(
        scenes.on_table((box("a"), (0, 0), 0.0, {}), (box("b"), (0.1 - depth, 0), 0.0, {})),
        RefineOptions(check_duration_s=0.01),
    )
    assert result.max_depth_m == pytest.approx(depth, abs=1e-5)
    assert result.s_pen == int(depth > 1e-3)


def test_a_stack_stands_and_a_ball_on_a_slope_does_not():
    still = measured(snap_exactly(scenes.blocks()))
    assert still.s_stab is True
    assert still.movable == 3
    assert still.max_drift_m < 1e-3
    ball = scenes.single("ball", (Sphere(radius=0.03), (0, 0, 0)))
    lean = {"base_tilt": (np.cos(0.2), 0, np.sin(0.2), 0)}
    ramp = scenes.block("ramp", (0.3, 0.2, 0.02))
    scene = scenes.on_table((ramp, (0, 0), 0.0, {**lean, "environment": True}))
    objects = (*scene.objects, SceneObject(name="ball", spec=ball, parent="ramp", z=0.1))
    rolling = measured(scene.model_copy(update={"objects": objects}))
    assert rolling.s_stab is False
    assert rolling.drift_m["ball"] > 0.1


@pytest.mark.parametrize(("aside", "above"), [(0.0, 0.0), (0.0003, 0.0), (0.0, -0.002)])
def test_sideways_overlap_with_a_wall_does_not_lift_an_object_over_it(aside, above):
    tray = scenes.single("tray", (HollowBox(size=(0.2, 0.2, 0.06), wall=0.006), (0, 0, 0)))
    base = scenes.on_table((tray, (0, 0), 0.0, {}))
    inside = SceneObject(
        name="inside",
        spec=box("inside", (0.06, 0.06, 0.05)),
        parent="tray",
        xy=(0.1 - 0.006 - 0.03 + aside - 0.01 * (not aside), 0.0),
        z=0.006 + 1e-4 + above,
        relation="in",
    )
    scene = base.model_copy(update={"objects": (*base.objects, inside)})
    assert snap_exactly(scene).object("inside").z == pytest.approx(0.006 + 1e-4, abs=2e-5)


@pytest.fixture
def fabricated(monkeypatch):
    """A scene, with the trajectory of five steps in place of a simulation.

    A block rises 3 cm, falls 2 cm, and turns by 10 degrees and back. A lamp's head turns by 20
    degrees on its ball, a drawer opens by 4 cm, a door by 7 degrees. Their bases rise by 1 mm.
    """
    lamp = scenes.lamp().object("lamp").model_copy(update={"xy": (0.0, -0.25)})
    scene = scenes.on_table((box("a"), (0, 0), 0.0, {}))
    cabinet = SceneObject(name="cabinet", spec=scenes.cabinet(), parent="table", xy=(0, 0.3), z=0.1)
    scene = scene.model_copy(update={"objects": (*scene.objects, lamp, cabinet)})

    def simulate(batch, steps):
        assert steps == round(0.01 / 0.002) == 5
        model, qpos = batch.model, np.repeat(batch.bind("qpos")[:, None], steps, axis=1)
        at = {model.joint(k).name: model.jnt_qposadr[k] for k in range(model.njnt)}
        a = model.jnt_qposadr[model.body("a").jntadr[0]]
        qpos[:, 1, a + 2] += 0.03
        qpos[:, 2, a + 2] -= 0.02
        qpos[:, 3, a + 3 : a + 7] = about_y(10.0)
        neck = slice(at["lamp-neck"], at["lamp-neck"] + 4)
        qpos[:, 2, neck] = quat_mul(qpos[:, 2, neck], about_y(-20.0))
        qpos[:, 1, at["cabinet-slide"]] -= 0.04
        qpos[:, 2, at["cabinet-hinge"]] -= np.radians(7.0)
        for name in ("lamp", "cabinet"):
            qpos[..., model.jnt_qposadr[model.body(name).jntadr[0]] + 2] += 1e-3
        return qpos, np.zeros(1, int)

    monkeypatch.setattr(rest, "_simulate", simulate)
    return scene


def about_y(degrees):
    half = np.radians(degrees) / 2
    return np.array([np.cos(half), 0.0, np.sin(half), 0.0])


def test_drift_and_tilt_are_those_of_the_worst_step_not_of_the_last(fabricated):
    found = measured(fabricated, RefineOptions(check_duration_s=0.01))
    assert (found.objects, found.movable, found.duration_s) == (4, 3, 0.01)
    assert found.drift_m == pytest.approx({"a": 0.03, "lamp": 1e-3, "cabinet": 1e-3})
    assert found.tilt_deg == pytest.approx({"a": 10.0, "lamp": 0.0, "cabinet": 0.0}, abs=1e-4)
    assert (found.max_drift_m, found.max_tilt_deg) == pytest.approx((0.03, 10.0))
    assert found.joint_slide_m == pytest.approx({"cabinet-slide": 0.04})
    turned = {"lamp-neck": 20.0, "cabinet-hinge": 7.0, "cabinet-turn": 0.0}
    assert found.joint_turn_deg == pytest.approx(turned, abs=1e-4)
    assert found.s_stab is False and not found.diverged


def test_each_bound_decides_and_a_motion_at_its_bound_is_over_it(fabricated):
    found = measured(fabricated, RefineOptions(check_duration_s=0.01))
    options = lambda **bounds: RefineOptions(check_duration_s=0.01, **bounds)
    stable = lambda **bounds: measured(fabricated, options(**bounds)).s_stab
    assert stable(max_drift_m=0.031, max_tilt_deg=10.1) is True
    assert stable(max_drift_m=found.max_drift_m, max_tilt_deg=10.1) is False
    assert stable(max_drift_m=0.031, max_tilt_deg=found.max_tilt_deg) is False
    assert stable(max_drift_m=0.031, max_tilt_deg=9.9) is False

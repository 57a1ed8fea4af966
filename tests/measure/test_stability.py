import numpy as np
import pytest

from neoworld_mjx.measure import scene_measure, stability, unstable_objects
from neoworld_mjx.physics.exact import snap_exactly
from neoworld_mjx.spec import Box, Cylinder, HollowBox, SceneObject, Sphere
from tests.support import scenes


def box(name, size=(0.1, 0.1, 0.1)):
    return scenes.single(name, (Box(size=size), (0, 0, 0)))


@pytest.mark.parametrize("depth", [0.0004, 0.004, 0.03])
def test_depth_of_two_boxes_side_by_side(depth):
    result = scene_measure(
        scenes.on_table((box("a"), (0, 0), 0.0, {}), (box("b"), (0.1 - depth, 0), 0.0, {})),
        duration=0.01,
    )
    assert result.max_depth_m == pytest.approx(depth, abs=1e-5)
    assert result.s_pen == int(depth > 1e-3)


def test_nested_objects_penetrate_even_if_concentric():
    small = box("small", (0.04, 0.04, 0.04))
    result = scene_measure(
        scenes.on_table((box("big"), (0, 0), 0.0, {}), (small, (0, 0), 0.0, {"z": 0.07})),
        duration=0.002,
    )
    # Out through a side or the top: 5 cm and 2 cm, the small one's own half size included.
    assert result.depths_m["big|small"] == pytest.approx(0.07, abs=1e-3)


@pytest.mark.parametrize(
    "at", [(0.05, 0, 0), (0, 0.05, 0.05), (0.05, 0.05, 0.05)], ids=["face", "edge", "corner"]
)
def test_an_overlap_is_deep_where_a_centre_lies_on_a_surface(at):
    # MuJoCo 3.17 calls these apart by the distance of their centres.
    small = box("small", (0.04, 0.04, 0.06))
    big = {"z": 0.3}
    scene = scenes.on_table(
        (box("big"), (0, 0), 0.0, big), (small, at[:2], 0.0, {"z": 0.3 + at[2]})
    )
    depth = scene_measure(scene, duration=0.002).depths_m["big|small"]
    assert depth == pytest.approx(0.02, abs=1e-4)


def test_a_stack_stands_and_a_ball_on_a_slope_does_not():
    still = scene_measure(snap_exactly(scenes.blocks()))
    assert still.s_stab is True
    assert still.movable == 3
    assert still.max_drift_m < 1e-3
    ball = scenes.single("ball", (Sphere(radius=0.03), (0, 0, 0)))
    lean = {"base_tilt": (np.cos(0.2), 0, np.sin(0.2), 0)}
    ramp = scenes.single("ramp", (Box(size=(0.3, 0.2, 0.02)), (0, 0, 0)))
    scene = scenes.on_table((ramp, (0, 0), 0.0, {**lean, "environment": True}))
    objects = (*scene.objects, SceneObject(name="ball", spec=ball, parent="ramp", z=0.1))
    rolling = scene_measure(scene.model_copy(update={"objects": objects}))
    assert rolling.s_stab is False
    assert rolling.drift_m["ball"] > 0.1


def test_rotation_counts_without_translation():
    pole = scenes.single("pole", (Cylinder(radius=0.004, height=0.3), (0, 0, 0.15)))
    scene = scenes.on_table((pole, (0, 0), 0.0, {"base_tilt": (np.cos(0.06), np.sin(0.06), 0, 0)}))
    result = scene_measure(scene)
    assert result.s_stab is False
    assert result.max_tilt_deg > 45


def test_stability_is_none_without_movable_objects():
    result = scene_measure(scenes.on_table(), duration=0.01)
    assert result.movable == 0
    assert result.s_stab is None
    assert result.s_pen == 0


def test_a_support_on_a_support_is_not_penetration():
    shelf = box("shelf")
    scene = scenes.on_table((shelf, (0, 0), 0.0, {"environment": True, "z": 0.0}))
    assert scene_measure(scene, duration=0.01).depths_m == {}


@pytest.mark.parametrize("off", [-0.003, 0.0, 0.01])
def test_snapping_exactly_leaves_the_gap(off):
    scene = scenes.on_table((scenes.cup(), (0, 0), 0.3, {"z": 0.04 + off}))
    snapped = snap_exactly(scene)
    assert snapped.object("cup").z == pytest.approx(0.0401, abs=2e-5)


def test_moving_objects_are_named_with_the_reason_those_that_fall_first():
    pole = scenes.single("pole", (Cylinder(radius=0.004, height=0.3), (0, 0, 0.15)))
    scene = scenes.on_table(
        (pole, (0, 0), 0.0, {"base_tilt": (np.cos(0.06), np.sin(0.06), 0, 0)}),
        (box("beside"), (0.5, 0), 0.0, {}),
        (box("deep"), (-0.2, 0.2), 0.0, {"z": 0.03}),
        (box("rests"), (-0.2, -0.2), 0.0, {"z": 0.04}),
        (box("rider"), (0, 0), 0.0, {"parent": "beside", "z": 0.1}),
    )
    entries = unstable_objects(scene, scene_measure(scene, duration=1.0))
    reasons = {entry.name: (entry.kind, entry.why) for entry in entries}
    assert reasons["beside"] == ("falls", "table is not below it, or does not hold it")
    assert reasons["rider"] == ("falls", "beside, which supports it, moves")
    assert reasons["pole"] == ("topples", "it does not rest on table")
    assert "rests" not in reasons
    assert [entry.kind for entry in entries[:2]] == ["falls", "falls"]
    assert entries[0].phrase().startswith(f"{entries[0].name} falls ")


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


def test_drift_and_tilt_are_those_of_the_worst_step_not_of_the_last(monkeypatch):
    """A block rises 3 cm, falls 2 cm, and turns by 10 degrees and back, as a drawer opens."""
    scene = scenes.on_table((box("a"), (0, 0), 0.0, {}), (scenes.cabinet(), (0, 0.3), 0.0, {}))
    steps = 5

    def simulate(model, data, count):
        assert count == round(0.01 / 0.002) == steps
        qpos = np.tile(data.qpos, (steps, 1))
        a = model.jnt_qposadr[model.body("a").jntadr[0]]
        qpos[1, a + 2] += 0.03
        qpos[2, a + 2] -= 0.02
        angle = np.radians(10.0) / 2
        qpos[3, a + 3 : a + 7] = [np.cos(angle), 0, np.sin(angle), 0]
        (slide,) = np.flatnonzero(model.jnt_type == 2)
        qpos[1, model.jnt_qposadr[slide]] -= 0.04
        hinges = np.flatnonzero(model.jnt_type == 3)
        qpos[2, model.jnt_qposadr[hinges[0]]] -= np.radians(7.0)
        return qpos, True

    monkeypatch.setattr(stability, "_simulate", simulate)
    found = scene_measure(scene, duration=0.01)
    assert found.max_drift_m == found.drift_m["a"] == pytest.approx(0.03)
    assert found.max_tilt_deg == found.tilt_deg["a"] == pytest.approx(10.0)
    assert found.drop_m["a"] == pytest.approx(0.02)
    assert found.drift_m["cabinet"] == found.tilt_deg["cabinet"] == found.drop_m["cabinet"] == 0.0
    assert max(found.joint_slide_m.values()) == pytest.approx(0.04)
    assert max(found.joint_turn_deg.values()) == pytest.approx(7.0)
    assert found.s_stab is False and not found.diverged
    # Either bound decides, and the value at a bound is over it.
    calm = {"duration": 0.01, "max_drift": 0.031, "max_tilt": 10.1}
    assert scene_measure(scene, **calm).s_stab is True
    assert scene_measure(scene, **calm | {"max_drift": 0.029}).s_stab is False
    assert scene_measure(scene, **calm | {"max_tilt": 9.9}).s_stab is False


def test_a_simulation_that_is_not_finite_is_unstable(monkeypatch):
    scene = scenes.on_table((box("a"), (0, 0), 0.0, {}))
    still = lambda model, data, steps: (np.tile(data.qpos, (steps, 1)), False)
    monkeypatch.setattr(stability, "_simulate", still)
    found = scene_measure(scene, duration=0.01)
    assert found.diverged and found.s_stab is False
    assert found.max_drift_m == found.max_tilt_deg == np.inf
    assert found.settled_depths_m == {} and found.settled_depth_m == 0.0

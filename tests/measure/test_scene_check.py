"""The bounds of a scene, each by itself, and who breaks them."""

import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.measure import measured, passes, scene_checks
from neoworld_mjx.physics.exact import snap_exactly
from neoworld_mjx.spec import Box, Cylinder, SceneObject
from tests.support import furniture, scenes

OPTIONS = RefineOptions()


def failing(scene):
    measure = measured(scene, OPTIONS)
    checks = scene_checks(measure, OPTIONS)
    failed = {check.name: check.where for check in checks if not check.passed}
    assert passes(measure, OPTIONS) == (not failed)
    return failed


def test_a_stack_satisfies_every_bound():
    assert failing(snap_exactly(scenes.blocks())) == {}


def test_two_penetrating_boxes_are_named():
    one, two = (scenes.single(name, (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0))) for name in "ab")
    scene = scenes.on_table((one, (0, 0), 0.0, {}), (two, (0.09, 0), 0.0, {}))
    failed = failing(scene)
    assert failed["max_depth_m"] == "a|b"


def test_a_rotating_object_fails_by_its_angle_alone():
    # A wheel on its axle's height rolls about its own axis: its base stays where it is.
    pole = scenes.single("pole", (Cylinder(radius=0.004, height=0.1), (0, 0, 0.05)))
    tilt = np.radians(6.0) / 2
    scene = scenes.on_table((pole, (0, 0), 0.0, {"base_tilt": (np.cos(tilt), np.sin(tilt), 0, 0)}))
    failed = failing(scene)
    assert failed["max_tilt_deg"] == "pole"
    assert "max_joint_turn_deg" not in failed and "max_depth_m" not in failed


def test_a_drawer_that_slides_open_by_itself_is_named():
    chest = furniture.chest()
    fixed = {"relation": "attached", "environment": False}
    joint = next(joint for joint in chest.joints if joint.type == "prismatic")
    loose = chest.model_copy(
        update={
            "fixed_base": True,
            "joints": tuple(
                j.model_copy(update={"friction": 0.0, "damping": 0.0}) if j is joint else j
                for j in chest.joints
            ),
        }
    )
    axis = np.array(joint.axis)
    # The axis points downhill by 30 degrees.
    across = np.cross(axis, [0.0, 0.0, -1.0])
    across = across / np.linalg.norm(across)
    turn = np.radians(30.0) / 2
    tilt = (float(np.cos(turn)), *(np.sin(turn) * across).tolist())
    scene = scenes.on_table()
    item = SceneObject(name="chest", spec=loose, parent="table", z=0.3, base_tilt=tilt, **fixed)
    failed = failing(scene.model_copy(update={"objects": (*scene.objects, item)}))
    assert failed.get("max_joint_slide_m", "").endswith(joint.name)


def test_a_value_that_is_not_finite_fails_every_bound():
    measure = measured(snap_exactly(scenes.blocks()), OPTIONS).model_copy(update={"diverged": True})
    failed = [check.name for check in scene_checks(measure, OPTIONS) if not check.passed]
    assert failed == [
        *("settled_depth_m", "max_drift_m", "max_tilt_deg", "max_joint_slide_m"),
        "max_joint_turn_deg",
    ]
    assert not passes(measure, OPTIONS)


def test_a_phrase_names_value_place_and_bound():
    measure = measured(snap_exactly(scenes.blocks()), OPTIONS)
    moved = measure.model_copy(update={"max_tilt_deg": 12.34, "tilt_deg": {"mug": 12.34}})
    (check,) = [check for check in scene_checks(moved, OPTIONS) if not check.passed]
    assert check.phrase() == "max_tilt_deg 12.3 of mug, over 5"

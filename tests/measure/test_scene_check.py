"""The bounds of a scene, each by itself, and who breaks them."""

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import RunError
from neoworld_mjx.measure import SETTLED_AWAY, measured, passes, scene_checks, with_displacement
from neoworld_mjx.physics.colliders import snap_exactly
from neoworld_mjx.spec import SceneObject
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


def test_an_object_that_settled_away_from_its_place_fails():
    measure = measured(snap_exactly(scenes.blocks()), OPTIONS)
    assert SETTLED_AWAY not in {check.name for check in scene_checks(measure, OPTIONS)}
    for value, passed in ((1.0, True), (1.01, False)):
        moved = with_displacement(measure, {"low": 0.3, "ball": value})
        check = scene_checks(moved, OPTIONS)[-1]
        assert (check.name, check.where, check.passed) == (SETTLED_AWAY, "ball", passed)
        assert passes(moved, OPTIONS) == passed
    with pytest.raises(RunError, match="damaged"):
        with_displacement(measure, {"low": "far"})


def test_depths_may_equal_their_bound_and_motions_may_not():
    """Each bound by itself, with the object, pair or joint of its largest value."""
    still = measured(snap_exactly(scenes.blocks()), OPTIONS)
    depth, drift, tilt = OPTIONS.max_depth_m, OPTIONS.max_drift_m, OPTIONS.max_tilt_deg
    rows = {
        "max_depth_m": ({"max_depth_m": depth, "depths_m": {"a|b": depth, "b|c": 0.0}}, True),
        "settled_depth_m": (
            {"settled_depth_m": depth, "settled_depths_m": {"b|c": 0.0, "a|b": depth}},
            True,
        ),
        "max_drift_m": ({"max_drift_m": drift, "drift_m": {"a|b": drift, "c": 0.0}}, False),
        "max_tilt_deg": ({"max_tilt_deg": tilt, "tilt_deg": {"c": 0.0, "a|b": tilt}}, False),
        "max_joint_slide_m": ({"joint_slide_m": {"c": 0.0, "a|b": drift}}, False),
        "max_joint_turn_deg": ({"joint_turn_deg": {"a|b": tilt, "c": 0.0}}, False),
    }
    for name, (update, passed) in rows.items():
        checks = {
            check.name: check for check in scene_checks(still.model_copy(update=update), OPTIONS)
        }
        assert list(checks) == list(rows)
        check = checks[name]
        assert (check.passed, check.where) == (passed, "a|b") and check.value == check.threshold
        assert all(other.passed for other in checks.values() if other is not check)
        joints = [checks[f"max_joint_{motion}"].value for motion in ("slide_m", "turn_deg")]
        assert sorted(joints) == [0.0, check.value] if "joint" in name else joints == [0.0, 0.0]

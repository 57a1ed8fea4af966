"""Measure of joints against ground truth."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from neoworld_bench.measures import joint_measure
from neoworld_bench.measures.joint_measure import (
    ObjectTruth,
    TrueJoint,
)

BOX = ((-0.2, -0.3, 0.0), (0.2, 0.3, 0.8))
SIZE = math.sqrt(0.4**2 + 0.6**2 + 0.8**2)
DOOR = TrueJoint(
    name="door",
    type="revolute",
    axis=(0, 0, 1),
    pivot=(0.2, 0.3, 0),
    limits=(0, 1.6),
    moving_box=((0.18, -0.3, 0.0), (0.2, 0.3, 0.5)),
)
DRAWER = TrueJoint(
    name="drawer",
    type="prismatic",
    axis=(1, 0, 0),
    limits=(0, 0.3),
    moving_box=((-0.15, -0.28, 0.55), (0.2, 0.28, 0.78)),
)
TRUTH = ObjectTruth(name="cabinet", box=BOX, joints=(DOOR, DRAWER))


def cabinet(*joints, **update):
    return TRUTH.model_copy(update={"joints": joints, **update})


def changed(joint, **update):
    return joint.model_copy(update=update)


def test_ground_truth_compared_with_itself_has_no_errors():
    result = joint_measure(TRUTH, TRUTH)
    assert (result.total, result.predicted, result.hits, result.correct) == (2, 2, 2, 2)
    assert (result.axis_deg.value, result.axis_deg.n) == (0, 2)
    assert (result.pivot.value, result.pivot.n) == (0, 1), "a slide has no pivot"


def test_sliding_door_is_a_hit_with_the_wrong_type():
    slid = changed(DOOR, type="prismatic", axis=(0, 1, 0), limits=(0, 0.3))
    result = joint_measure(cabinet(slid, DRAWER), TRUTH)
    assert result.hits == 2 and result.correct == 1
    assert result.axis_deg.n == 2 and result.axis_deg.value == pytest.approx(45)
    assert result.pivot.n == 0 and result.limits.n == 1


@settings(max_examples=40, deadline=None)
@given(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(0, 80), st.floats(-0.3, 0.3))
def test_axis_and_pivot_errors_equal_the_applied_displacement(dx, dy, tilt, along):
    """The axis tilted about the line to it: angle is the tilt, distance the shift."""
    a = math.radians(tilt)
    built = changed(DOOR, axis=(0, math.sin(a), math.cos(a)), pivot=(0.2 + dx, 0.3, 0))
    true = changed(DOOR, pivot=(0.2, 0.3, 0))
    pair = joint_measure(cabinet(built), cabinet(true)).pairs[0]
    assert pair.axis_deg == pytest.approx(tilt, abs=1e-4)
    if tilt > 6:
        assert pair.pivot == pytest.approx(abs(dx) / SIZE, abs=1e-9)
    shifted = changed(DOOR, pivot=(0.2 + dx, 0.3 + dy, along))
    pair = joint_measure(cabinet(shifted), cabinet(true)).pairs[0]
    assert pair.pivot == pytest.approx(math.hypot(dx, dy) / SIZE, abs=1e-9)

"""Displacement, scaling and rotation of objects between two scenes."""

import math

import numpy as np
import pytest

from neoworld_mjx.measure import object_moves
from neoworld_mjx.spec.pose import from_axis_angle
from tests.support import scenes
from tests.support.scenes import changed


def test_moves_are_in_world_coordinates():
    before = scenes.blocks()
    low = before.object("low")
    pushed = {"xy": (low.xy[0] + 0.03, low.xy[1]), "yaw": low.yaw + 0.1}
    moves = object_moves(before, changed(before, "low", **pushed))
    assert set(moves) == {"low", "high", "ball"}
    assert moves["low"] == pytest.approx((0.03, 1.0, np.degrees(0.1), np.degrees(0.1)))
    # What stands on it goes along, and nothing else moves.
    assert moves["high"].distance_m > 0.028 and moves["ball"] == pytest.approx((0.0, 1.0, 0.0, 0.0))


def test_a_heading_turns_the_shorter_way_and_a_tilt_counts_in_the_whole_rotation():
    scene = scenes.blocks()
    one, other = (
        changed(scene, "low", yaw=math.radians(170)),
        changed(scene, "low", yaw=math.radians(-170)),
    )
    assert object_moves(one, other)["low"].yaw_deg == pytest.approx(20.0)
    assert object_moves(other, one)["low"].yaw_deg == pytest.approx(-20.0)
    assert object_moves(other, one)["low"].turn_deg == pytest.approx(20.0)
    across = changed(scene, "low", yaw=math.radians(50))
    assert object_moves(one, across)["low"].yaw_deg == pytest.approx(-120.0)
    tilted = changed(scene, "low", base_tilt=tuple(from_axis_angle([1, 0, 0], 0.5).tolist()))
    move = object_moves(changed(scene, "low", yaw=0.0), tilted.model_copy())["low"]
    assert move.turn_deg > 28.0

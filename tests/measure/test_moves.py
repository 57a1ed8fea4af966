"""Displacement, scaling and rotation of objects between two scenes."""

import math

import numpy as np
import pytest

from neoworld_mjx.measure import object_moves
from neoworld_mjx.spec.pose import from_axis_angle
from tests.support import scenes


def changed(scene, **update):
    """The scene with fields of `low` changed."""
    objects = tuple(o.model_copy(update=update) if o.name == "low" else o for o in scene.objects)
    return scene.model_copy(update={"objects": objects})


def test_moves_are_in_world_coordinates():
    before = scenes.blocks()
    low = before.object("low")
    pushed = low.model_copy(update={"xy": (low.xy[0] + 0.03, low.xy[1]), "yaw": low.yaw + 0.1})
    objects = tuple(pushed if item.name == "low" else item for item in before.objects)
    moves = object_moves(before, before.model_copy(update={"objects": objects}))
    assert set(moves) == {"low", "high", "ball"}
    assert moves["low"] == pytest.approx((0.03, 1.0, np.degrees(0.1), np.degrees(0.1)))
    # What stands on it goes along, and nothing else moves.
    assert moves["high"].distance_m > 0.028 and moves["ball"] == pytest.approx((0.0, 1.0, 0.0, 0.0))


def test_a_heading_turns_the_shorter_way_and_a_tilt_counts_in_the_whole_rotation():
    scene = scenes.blocks()
    one, other = changed(scene, yaw=math.radians(170)), changed(scene, yaw=math.radians(-170))
    assert object_moves(one, other)["low"].yaw_deg == pytest.approx(20.0)
    assert object_moves(other, one)["low"].yaw_deg == pytest.approx(-20.0)
    assert object_moves(other, one)["low"].turn_deg == pytest.approx(20.0)
    across = changed(scene, yaw=math.radians(50))
    assert object_moves(one, across)["low"].yaw_deg == pytest.approx(-120.0)
    tilted = changed(scene, base_tilt=tuple(from_axis_angle([1, 0, 0], 0.5).tolist()))
    move = object_moves(changed(scene, yaw=0.0), tilted.model_copy())["low"]
    assert move.turn_deg > 28.0

"""Headings of a layout's objects, by analytic cases."""

import math

import numpy as np
import pytest
from neoworld_bench.methods.layout_errors import heading_deg

from neoworld_mjx.spec import Box, Cylinder, SceneObject
from neoworld_mjx.spec.pose import IDENTITY, Pose, from_axis_angle, from_yaw, quat_mul
from tests.support.scenes import single

LEAN = tuple(from_axis_angle((1.0, 0.0, 0.0), math.radians(30.0)))
UPRIGHT = tuple(from_axis_angle((1.0, 0.0, 0.0), math.radians(3.0)))
LYING = tuple(from_axis_angle((1.0, 0.0, 0.0), math.radians(90.0)))
ROD = Cylinder(radius=0.004, height=0.17)
BAR = Box(size=(0.01, 0.01, 0.17))
BRICK = Box(size=(0.1, 0.06, 0.04))
ORIGIN = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("shape", "tilt", "turn_deg", "roll_deg", "expected"),
    [
        (ROD, LEAN, 0.0, 110.0, 0.0),
        (ROD, LEAN, 40.0, 110.0, 40.0),
        (ROD, LEAN, 170.0, 0.0, 170.0),
        (BAR, LEAN, 0.0, 90.0, 0.0),
        (BAR, LEAN, 25.0, 180.0, 25.0),
        (ROD, LYING, 180.0, 50.0, 0.0),
        (ROD, LYING, 30.0, 0.0, 30.0),
        (ROD, IDENTITY, 30.0, 0.0, None),
        (ROD, UPRIGHT, 30.0, 0.0, None),
        (BRICK, IDENTITY, 10.0, 0.0, 10.0),
        (BRICK, IDENTITY, 170.0, 0.0, 10.0),
        (BRICK, LEAN, 20.0, 0.0, 20.0),
    ],
)
def test_heading_ignores_rolls_about_an_axis_of_symmetry(shape, tilt, turn_deg, roll_deg, expected):
    item = SceneObject(name="thing", spec=single("thing", (shape, ORIGIN)), base_tilt=tilt)
    start = np.array(tilt)
    end = quat_mul(from_yaw(math.radians(turn_deg)), start)
    end = quat_mul(end, from_yaw(math.radians(roll_deg)))
    heading = heading_deg(item, Pose(np.zeros(3), end), Pose(np.zeros(3), start))
    assert heading == (None if expected is None else pytest.approx(expected, abs=1e-6))

"""Signs of the camera's angles."""

import numpy as np
import pytest

from neoworld_mjx.spec import Camera

SIZE = {"width": 600, "height_px": 400, "fovy": 0.8, "height": 1.0}


def pixel(point, **angles):
    camera = Camera(**SIZE, **{"pitch": 0.0, **angles})
    (u, v), depth = camera.project(np.array(point, float))
    assert depth > 0
    assert np.allclose(np.cross(camera.rays([u, v]), np.array(point) - camera.position()), 0)
    return u - 300, v - 200


def test_points_to_the_left_and_above_are_left_and_above_in_the_image():
    u, v = pixel((2.0, 0.5, 1.3))
    assert u < 0 and v < 0


def test_a_camera_that_looks_down_sees_the_horizon_above():
    u, v = pixel((2.0, 0.0, 1.0), pitch=0.2)
    assert u == pytest.approx(0) and v < 0


def test_a_camera_that_rolls_clockwise_sees_the_scene_turn_counterclockwise():
    """Seen from behind, a point to the right of the view moves up in the image."""
    u, v = pixel((2.0, -0.5, 1.0), roll=0.2)
    assert u > 0 and v < 0
    assert np.arctan2(-v, u) == pytest.approx(0.2)
    u, v = pixel((2.0, 0.0, 1.5), roll=0.2)
    assert u < 0 and v < 0

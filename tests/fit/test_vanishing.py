import math

import numpy as np
import pytest

from neoworld_mjx.errors import SpecError
from neoworld_mjx.fit.vanishing_points import camera_of_lines
from neoworld_mjx.spec import Camera

EMPTY = Camera(width=800, height_px=600, fovy=math.radians(45), height=1.2, pitch=0.6)


def _lines(camera, yaw, noise=0.0, seed=0):
    """Return two lines on the ground along a heading and two across it, as the camera sees them."""
    c, s = math.cos(yaw), math.sin(yaw)
    turn, middle = np.array([[c, -s], [s, c]]), np.array([2.0, 0.0])
    square = np.array(
        [[[-1, -1], [1, -1]], [[-1, 1], [1, 1]], [[-1, -1], [-1, 1]], [[1, -1], [1, 1]]]
    )
    ground = square @ turn.T * 0.5 + middle
    pixels, depth = camera.project(np.concatenate([ground, np.zeros((4, 2, 1))], axis=2))
    assert (depth > 0).all()
    pixels = pixels + np.random.default_rng(seed).normal(0, noise, pixels.shape)
    return pixels[:2], pixels[2:]


@pytest.mark.parametrize("roll", [-0.2, 0.0, 0.15])
@pytest.mark.parametrize(("pitch", "fovy"), [(0.35, 0.7), (0.9, 1.1)])
@pytest.mark.parametrize("yaw", [0.5, 1.0])
def test_lines_of_a_floor_give_the_camera(pitch, fovy, roll, yaw):
    true = EMPTY.model_copy(update={"pitch": pitch, "fovy": fovy, "roll": roll})
    found, finds_lens = camera_of_lines(EMPTY, *_lines(true, yaw))
    assert finds_lens
    for field in ("pitch", "roll", "fovy"):
        assert getattr(found, field) == pytest.approx(getattr(true, field), abs=1e-6), field
    assert found.height == EMPTY.height


def test_lines_perpendicular_to_the_view_keep_the_field_of_view():
    true = EMPTY.model_copy(update={"pitch": 0.5})
    found, finds_lens = camera_of_lines(EMPTY, *_lines(true, 0.0))
    assert not finds_lens
    assert (found.fovy, found.pitch) == (pytest.approx(true.fovy), pytest.approx(0.5, abs=1e-6))


def test_errors_of_a_pixel_cost_at_most_two_degrees():
    true = EMPTY.model_copy(update={"pitch": 0.6, "fovy": 0.9})
    off = []
    for seed in range(20):
        found, _ = camera_of_lines(EMPTY, *_lines(true, 0.7, noise=1.0, seed=seed))
        off.append(abs(math.degrees(found.pitch - true.pitch)))
    assert np.median(off) < 1.0


def test_degenerate_lines_are_rejected():
    along, across = _lines(EMPTY, 0.6)
    with pytest.raises(SpecError, match="one direction"):
        camera_of_lines(EMPTY, along, along + 1e-3)
    with pytest.raises(SpecError, match="too short"):
        camera_of_lines(EMPTY, along, np.full((2, 2, 2), 5.0))
    with pytest.raises(SpecError, match="lie on each other"):
        camera_of_lines(EMPTY, along[[0, 0]], across)

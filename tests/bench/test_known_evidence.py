"""Evidence made from the ground truth: its errors, and errors in the camera's frame."""

import numpy as np
import pytest
from neoworld_bench.noise.known_evidence import (
    AFFINE,
    EXIF_SD,
    HOLES,
    known_evidence,
)
from scipy.ndimage import binary_dilation

from neoworld_mjx.evidence.depth_image import MONOCULAR, sensor_sd
from neoworld_mjx.render.rasterize import draw_scene
from tests.estimate import desk

PHOTO = np.zeros((480, 640, 3), np.uint8)


def given(*kinds, number=0):
    return known_evidence(kinds, desk.five(), PHOTO, number)


@pytest.fixture(scope="module")
def drawn():
    return draw_scene(desk.five(), desk.CAMERA, 640)


@pytest.fixture(scope="module")
def edges(drawn):
    """Pixels next to those of another object, where sensors mix depths."""
    change = np.zeros(drawn.owner.shape, bool)
    change[1:] |= drawn.owner[1:] != drawn.owner[:-1]
    change[:, 1:] |= drawn.owner[:, 1:] != drawn.owner[:, :-1]
    return binary_dilation(change, iterations=2)


def test_a_calibrated_camera_is_exact_and_exif_data_are_not():
    known, exif = given("fov", "pose").camera, given("exif", "pose").camera
    assert known.camera(desk.CAMERA.model_copy(update={"pitch": 0.2, "fovy": 0.5})) == desk.CAMERA
    assert known.focal_sd < 1e-3 and exif.focal_sd == EXIF_SD
    logs = [np.log(given("exif", number=k).camera.focal / desk.CAMERA.focal) for k in range(200)]
    assert np.std(logs) == pytest.approx(EXIF_SD, rel=0.2)
    assert given("pose").camera.focal is None


def test_a_sensor_has_noise_holes_and_flying_pixels(drawn, edges):
    depth = given("depth").depth
    assert depth.kind == "metric" and not depth.smooth_sd
    measured, shown = np.isfinite(depth.values), np.isfinite(drawn.depth)
    assert not measured[~shown & ~edges].any()
    assert 1 - measured[shown].mean() == pytest.approx(HOLES, abs=0.01)
    off = (depth.values - drawn.depth) / sensor_sd(drawn.depth)
    assert off[measured & shown & ~edges].std() == pytest.approx(1, abs=0.03)
    # A flying pixel is at neither of the depths at an edge.
    assert (np.abs(off[measured & shown & edges]) > 5).mean() > 0.05
    assert (np.abs(off[measured & shown & ~edges]) > 5).mean() < 1e-3


@pytest.mark.parametrize("kind", ["affine", "disparity"])
def test_a_network_has_smooth_errors_and_unknown_units(kind, drawn, edges):
    depth = given(kind).depth
    assert depth.kind == kind and depth.smooth_sd == MONOCULAR
    inner = np.isfinite(depth.values) & np.isfinite(drawn.depth) & ~edges
    true = drawn.depth if kind == "affine" else 1 / drawn.depth
    scale, shift = np.polyfit(depth.values[inner], true[inner], 1)
    fitted = scale * depth.values + shift
    error = np.abs(fitted / true - 1)
    assert MONOCULAR / 4 < error[inner].mean() < MONOCULAR
    if kind == "affine":
        assert scale == pytest.approx(AFFINE[0], rel=0.3)

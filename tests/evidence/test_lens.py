"""Lenses with distortion, and their undistorted images."""

import numpy as np
import pytest

from neoworld_mjx.evidence.depth_image import DepthImage
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.evidence_file import undistorted
from neoworld_mjx.evidence.file_camera import Distortion, FileCamera, known_camera
from neoworld_mjx.evidence.lens import Lens, is_pinhole, pinhole_of, undistorted_image
from neoworld_mjx.evidence.masks import Masks

BARREL = Lens((320, 240), (260.0, 262.0), (158.0, 121.0), coefficients=(-0.28, 0.07, 1e-3, -5e-4))
PINCUSHION = Lens((320, 240), (260.0, 262.0), (158.0, 121.0), coefficients=(0.2, 0.05, 0.0, 0.0))
FISHEYE = Lens((320, 240), (180.0, 180.0), (160.0, 120.0), "fisheye", (0.02, -0.003, 0.001, 0.0))
WIDE = Lens((320, 240), (180.0, 180.0), (160.0, 120.0), "fisheye")
STRETCHED = Lens((320, 240), (300.0, 250.0), (160.0, 120.0))
LENSES = {
    "barrel": BARREL,
    "pincushion": PINCUSHION,
    "fisheye": FISHEYE,
    "ideal fisheye": WIDE,
    "stretched": STRETCHED,
}


@pytest.mark.parametrize("name", LENSES)
def test_lines_of_sight_are_the_inverse_of_the_projection(name):
    lens = LENSES[name]
    rng = np.random.default_rng(0)
    pixels = rng.uniform([0, 0], lens.size, (200, 2))
    flat = lens.slopes(pixels)
    points = np.concatenate([flat, np.ones((200, 1))], axis=1) * rng.uniform(0.3, 3, (200, 1))
    assert np.allclose(lens.project(points), pixels, atol=1e-3)


def test_brown_conrady_is_that_of_opencv():
    # cv2.projectPoints of (0.3, -0.2, 1) with K = (260, 262, 157.5, 120.5) and these coefficients.
    x, y, k1, k2, p1, p2 = 0.3, -0.2, -0.28, 0.07, 1e-3, -5e-4
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    assert np.allclose(BARREL.project(np.array([x, y, 1.0])), [260 * u + 158, 262 * v + 121])


@pytest.mark.parametrize("name", LENSES)
def test_undistorted_image_shows_each_point_where_a_pinhole_camera_has_it(name):
    """A smooth function of the line of sight is seen through the lens, and undistorted."""
    lens = LENSES[name]
    pinhole = pinhole_of(lens)
    pattern = lambda flat: np.sin(9 * flat[..., 0]) + np.cos(7 * flat[..., 1])
    width, height = lens.size
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    image = pattern(lens.slopes(np.stack([u, v], axis=-1)))
    result = undistorted_image(image, lens, pinhole, smooth=True)
    assert result.shape == pinhole.size[::-1]
    u, v = np.meshgrid(np.arange(pinhole.size[0]) + 0.5, np.arange(pinhole.size[1]) + 0.5)
    seen = (np.stack([u, v], axis=-1) - pinhole.center) / pinhole.focal
    inside = result[2:-2, 2:-2]
    assert np.abs(inside - pattern(seen)[2:-2, 2:-2]).max() < 0.05
    colors = np.stack([image, -image, 2 * image], axis=-1)
    expected = np.stack([result, -result, 2 * result], axis=-1)
    assert np.allclose(undistorted_image(colors, lens, pinhole, smooth=True), expected)


def test_depth_confidence_and_masks_are_undistorted_like_the_photograph():
    """A wall whose depth, confidence and mask change along x, seen through the lens."""
    width, height = BARREL.size
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x = BARREL.slopes(np.stack([u, v], axis=-1))[..., 0]
    masks = Masks((x > 0.1).astype(int), {"wall": 1})
    evidence = Evidence(depth=DepthImage(2 + x, confidence=0.5 + x / 4), masks=masks, lens=BARREL)
    seen = undistorted(evidence)
    pinhole = pinhole_of(BARREL)
    x = (np.arange(pinhole.size[0]) + 0.5 - pinhole.center[0]) / pinhole.focal
    x = np.broadcast_to(x, pinhole.size[::-1])
    assert seen.lens is None and seen.photo is None
    assert seen.depth is not None and seen.depth.confidence is not None and seen.masks is not None
    inside = np.s_[2:-2, 2:-2]
    assert np.abs(seen.depth.values - 2 - x)[inside].max() < 0.01
    assert np.abs(seen.depth.confidence - 0.5 - x / 4)[inside].max() < 0.01
    clear = np.abs(x - 0.1) > 0.01
    assert np.array_equal(seen.masks.labels[clear], (x > 0.1)[clear])
    assert seen.masks.names == {"wall": 1}


def test_distortion_and_pixels_that_are_not_square_undistort_the_photograph():
    distortion = Distortion(coefficients=(-0.3, 0.1))
    camera = FileCamera(fx=500, fy=500, cx=319.5, cy=239.5, distortion=distortion)
    known, lens = known_camera(camera, (640, 480), "camera")
    assert lens is not None and not is_pinhole(lens)
    assert known.size == (640, 480) and known.focal == pinhole_of(lens).focal
    squeezed = FileCamera(fx=500, fy=375, cx=319.5, cy=179.5)
    known, lens = known_camera(squeezed, (640, 360), "camera")
    assert lens is not None and known.size == (640, 480)
    assert known.focal == pytest.approx(500, rel=1e-2)

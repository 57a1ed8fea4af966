"""Depth images: formats, missing values, flying pixels, and sensors next to the camera."""

import json

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.errors import EvidenceError
from neoworld_mjx.evidence.depth_files import flying_pixels, read_depth, registered
from neoworld_mjx.evidence.depth_image import DepthImage
from neoworld_mjx.evidence.evidence_file import StatedEvidence, evidence_of
from neoworld_mjx.evidence.lens import Lens
from tests.support.made_up_view import BOXES, DEPTHS, depth


def png16(path, values, per_meter=1000):
    units = np.nan_to_num(values * per_meter).round().astype(np.uint16)
    Image.fromarray(units).save(path)


def same(read, given, within=6e-4):
    known = np.isfinite(read.values)
    assert known.mean() > 0.95
    assert np.abs(read.values - given)[known].max() < within


@pytest.mark.parametrize("suffix", ["png", "png at 1/10000", "npy", "npz", "float16"])
def test_formats(tmp_path, suffix):
    given, file, scale = depth(), tmp_path / f"depth.{suffix[:3]}", None
    if suffix == "png":
        png16(file, given)
    elif suffix.startswith("png"):
        png16(file, given, 10_000)
        scale = 1e-4
    elif suffix == "npz":
        np.savez_compressed(file, depth=given.astype(np.float32), intrinsics=np.eye(3))
    else:
        file = tmp_path / "depth.npy"
        np.save(file, given.astype(np.float16 if suffix == "float16" else np.float32))
    read = read_depth(file, scale=scale)
    same(read, given)
    assert read.kind == "metric" and read.smooth_sd == 0 and read.source == file.name
    assert np.isnan(read.values[:6]).all()


def test_zero_nan_infinite_and_negative_depths_are_missing(tmp_path):
    values = np.full((40, 40), 0.8)
    values[0, :4] = [0, np.nan, np.inf, -1]
    np.save(tmp_path / "depth.npy", values)
    read = read_depth(tmp_path / "depth.npy")
    assert np.isnan(read.values[0, :4]).all() and np.isfinite(read.values).sum() == 1596


@pytest.mark.parametrize(
    ("name", "write", "message"),
    [
        ("a.png", lambda p: Image.new("RGB", (64, 64)).save(p), "has colors"),
        ("a.png", lambda p: Image.new("L", (64, 64), 9).save(p), "8 bits"),
        ("a.png", lambda p: p.write_bytes(b"no image"), "not an image"),
        ("a.png", lambda p: png16(p, np.zeros((64, 64))), "has no values"),
        ("a.npy", lambda p: np.save(p, np.ones((3, 64, 64))), "two axes"),
        ("a.npy", lambda p: np.save(p, np.ones((4, 4))), "valid are 16"),
        ("a.npy", lambda p: np.save(p, np.array(["a"] * 20)), "not numbers"),
        ("a.npz", lambda p: np.savez(p, a=np.ones(3), b=np.ones(3)), "name the one to use depth"),
        ("a.exr", lambda p: p.write_bytes(b""), "EXR files are not read: save it as .npy"),
        ("a.npy", lambda p: np.save(p, np.array([{}]), allow_pickle=True), "no readable arrays"),
    ],
)
def test_files_that_are_no_depth_image_give_one_message(tmp_path, name, write, message):
    write(tmp_path / name)
    with pytest.raises(EvidenceError, match=message):
        read_depth(tmp_path / name)


def test_flying_pixels_between_two_surfaces_are_removed_and_no_others():
    values = depth()
    left, top, _, bottom = BOXES["green"]
    edge = values[top:bottom, left - 1].copy()
    values[top:bottom, left - 1] = (edge + DEPTHS["green"]) / 2
    flying = flying_pixels(values)
    assert flying[top + 2 : bottom - 2, left - 1].all()
    flying[top - 2 : bottom + 2, left - 3 : left + 2] = False
    assert flying.mean() < 1e-3


def boxes_seen_by(lens, offset=(0.0, 0.0, 0.0)):
    """Return depths of a wall at 1.5 m with a square at .8 m, seen from an offset camera."""
    width, height = lens.size
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    flat = lens.slopes(np.stack([u, v], axis=-1))
    near = flat * (0.8 - offset[2]) + offset[:2]
    square = np.abs(near).max(axis=-1) < 0.15
    return np.where(square, 0.8, 1.5) - offset[2]


def test_depth_of_a_sensor_beside_the_camera_is_seen_from_the_camera():
    photo = Lens((320, 240), (300.0, 300.0), (160.0, 120.0))
    sensor = Lens((212, 160), (190.0, 190.0), (106.0, 80.0))
    offset = np.array([0.06, -0.02, 0.01])  # Of the sensor in the photograph's camera.
    to_photo = np.eye(4)
    to_photo[:3, 3] = offset
    given = DepthImage(boxes_seen_by(sensor, offset), confidence=np.ones((160, 212)))
    read = registered(given, sensor, to_photo, photo)
    rows, columns = read.values.shape
    small = Lens(
        (columns, rows),
        (300.0 * columns / 320, 300.0 * rows / 240),
        (160.0 * columns / 320, 120.0 * rows / 240),
    )
    expected, known = boxes_seen_by(small), np.isfinite(read.values)
    assert known[10:-10, 30:-10].mean() > 0.85
    off = np.abs(read.values - expected) > 0.02
    assert (off & known).mean() < 0.01
    # The square is nearer than the wall beside it, which it hides from the camera.
    assert (read.values[known & (expected < 1)] < 0.85).mean() > 0.97
    assert set(np.unique(read.confidence[known])) == {1.0}


def test_sensor_beside_the_camera_and_scale_of_bop_in_an_evidence_file(tmp_path):
    photo = Lens((320, 240), (300.0, 300.0), (160.0, 120.0))
    values = boxes_seen_by(photo)
    png16(tmp_path / "depth.png", values, 10_000)
    lens = {"cam_K": [300, 0, 159.5, 0, 300, 119.5, 0, 0, 1], "depth_scale": 0.1}
    (tmp_path / "scene_camera.json").write_text(json.dumps({"3": lens}))
    sensor = {"fx": 300, "fy": 300, "cx": 159.5, "cy": 119.5}
    (tmp_path / "sensor.json").write_text(json.dumps(sensor))
    to_photo = np.eye(4)
    to_photo[2, 3] = 0.2  # The sensor is 20 cm ahead of the camera.
    stated = StatedEvidence(
        camera=str(tmp_path / "scene_camera.json"),
        depth={
            "file": str(tmp_path / "depth.png"),
            "camera": str(tmp_path / "sensor.json"),
            "to_photo": to_photo.tolist(),
        },
        check=False,
    )
    read = evidence_of(stated, "000003.png", np.zeros((240, 320, 3), np.uint8), (320, 240))
    known = read.depth.values[np.isfinite(read.depth.values)]
    assert known.min() == pytest.approx(1.0, abs=1e-3)
    assert known.max() == pytest.approx(1.7, abs=1e-3)

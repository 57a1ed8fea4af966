"""Depth images: formats, missing values, and flying pixels."""

import json

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.errors import EvidenceError
from neoworld_mjx.evidence.depth_files import flying_pixels, read_depth
from neoworld_mjx.evidence.evidence_file import StatedEvidence, evidence_of
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


def test_scale_of_bop_in_an_evidence_file(tmp_path):
    values = np.linspace(1.0, 1.7, 320) + np.zeros((240, 1))
    png16(tmp_path / "depth.png", values, 10_000)
    lens = {"cam_K": [300, 0, 159.5, 0, 300, 119.5, 0, 0, 1], "depth_scale": 0.1}
    (tmp_path / "scene_camera.json").write_text(json.dumps({"3": lens}))
    files = {"camera": str(tmp_path / "scene_camera.json"), "depth": str(tmp_path / "depth.png")}
    stated = StatedEvidence(**files, check=False)
    read = evidence_of(stated, "000003.png", np.zeros((240, 320, 3), np.uint8), (320, 240))
    assert np.allclose(read.depth.values, values, atol=1e-4)

"""Image measures with tiny random models in the file formats of the published ones."""

import sys

import numpy as np
import pytest
from neoworld_bench.measures import picture_similarity
from neoworld_bench.measures.picture_similarity import (
    MEASURES,
    PictureModels,
    Preprocessing,
    colored_points,
    grouped,
    ssim,
)
from scipy.ndimage import gaussian_filter

from neoworld_mjx.errors import ConfigError, PhotoError
from neoworld_mjx.spec import GeomSpec, Material, ObjectSpec, PartSpec
from neoworld_mjx.spec.primitives import Box

try:
    import onnxruntime  # noqa: F401

    from tests.support import onnx_models as made
except ImportError:
    made = None
needs_onnx = pytest.mark.skipif(
    made is None, reason="onnx and onnxruntime are not installed: the extras dev and metrics"
)


def picture(seed=0, height=48, width=64):
    """A smooth random picture."""
    noise = np.random.default_rng(seed).uniform(size=(height, width, 3))
    smooth = gaussian_filter(noise, (3, 3, 0))
    smooth = (smooth - smooth.min()) / np.ptp(smooth)
    return (255 * smooth).round().astype(np.uint8)


def block():
    """A red block with a blue one on top."""
    materials = (
        Material(name="red", density=500.0, rgba=(1, 0, 0, 1)),
        Material(name="blue", density=500.0, rgba=(0, 0, 1, 1)),
    )
    geoms = (
        GeomSpec(name="low", shape=Box(size=(0.2, 0.2, 0.2)), material="red"),
        GeomSpec(name="top", shape=Box(size=(0.2, 0.2, 0.2)), pos=(0, 0, 0.2), material="blue"),
    )
    part = PartSpec(name="body", geoms=geoms)
    return ObjectSpec(name="block", parts=(part,), materials=materials)


def test_ssim_is_one_for_equal_images_and_falls_with_shift_and_blur():
    rgb = picture()
    shifts = [ssim(rgb, np.roll(rgb, k, axis=1)) for k in (0, 1, 4, 12)]
    assert shifts[0] == 1.0 and shifts == sorted(shifts, reverse=True)
    assert ssim(rgb, gaussian_filter(rgb, (2, 2, 0))) < 0.99
    with pytest.raises(PhotoError, match="64 x 48 and 64 x 40"):
        ssim(picture(), picture(height=40))


def test_ssim_matches_scikit_image():
    # structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    # data_range=255, channel_axis=2) of scikit-image 0.26.0.
    rows, columns = np.mgrid[:20, :24]
    a = np.stack([(7 * rows + 3 * columns) % 256, rows * columns % 256, 11 * columns % 256], -1)
    a = a.astype(np.uint8)
    assert ssim(a, a[::-1]) == pytest.approx(0.217780461424, abs=1e-9)


def test_preprocessing_resizes_the_shorter_side_and_crops_the_center():
    config = {
        "size": {"shortest_edge": 8},
        "crop_size": {"height": 4, "width": 4},
        "image_mean": (0.5, 0.5, 0.5),
        "image_std": (0.5, 0.25, 1.0),
        "resample": 0,
    }
    columns = np.repeat(np.arange(24, dtype=np.uint8), 2)
    rgb = np.repeat(np.repeat(columns[None], 16, axis=0)[..., None], 3, axis=2)
    tensor = Preprocessing.model_validate(config).tensor(rgb)
    assert tensor.shape == (1, 3, 4, 4)
    expected = np.arange(10, 14) / 255 - 0.5
    assert tensor[0, 2, 0] == pytest.approx(expected, abs=1e-6)
    assert tensor[0, 1, 0] == pytest.approx(expected / 0.25, abs=1e-5)


def test_points_have_colors_and_groups_their_nearest_points():
    cloud = colored_points(block(), {}, count=400)
    assert cloud.shape == (400, 6) and (cloud[:, 2] > -0.11).all()
    upper, lower = cloud[:, 2] > 0.11, cloud[:, 2] < 0.09
    assert (cloud[upper, 3:] == [0, 0, 1]).all() and (cloud[lower, 3:] == [1, 0, 0]).all()
    center, features = grouped(cloud, 16, 8)
    assert center.shape == (16, 3) and features.shape == (16, 8, 6)
    # The nearest point of a group is its center, and centers are apart.
    assert np.abs(features[:, 0, :3]).max() == 0
    assert np.unique(center, axis=0).shape == center.shape


@needs_onnx
def test_measures_of_equal_and_degraded_images(tmp_path, monkeypatch):
    monkeypatch.setattr(picture_similarity, "GROUPS", 24)
    monkeypatch.setattr(picture_similarity, "GROUP_SIZE", 8)
    models = PictureModels(
        clip=made.clip_folder(tmp_path / "clip"),
        dino=made.dino_folder(tmp_path / "dino"),
        lpips=made.lpips_file(tmp_path / "lpips.onnx"),
        uni3d=made.uni3d_folder(tmp_path / "uni3d"),
    )
    assert set(models.described()) == {"lpips", "clip", "dino", "uni3d"}
    rgb, cloud = picture(), colored_points(block(), {}, count=200)
    same = models.compare(rgb, rgb, cloud)
    assert (same["clip"], same["dino"], same["lpips"]) == pytest.approx((1, 1, 0), abs=1e-12)
    assert -1 <= same["uni3d"] <= 1
    for worse in (np.roll(rgb, 4, axis=1), picture(seed=1)):
        other = models.compare(rgb, worse, cloud)
        assert other["clip"] < 1 and other["dino"] < 1 and other["lpips"] > 0.001
        assert other["uni3d"] == same["uni3d"]  # of the photograph and the points
    with pytest.raises(ConfigError, match=r"lpips\.onnx takes ina, inb and fails"):
        models.lpips.run({"ina": np.zeros((1, 3, 8, 8))})


def test_without_models_ssim_alone_is_measured_and_wrong_files_are_refused(tmp_path, monkeypatch):
    measured = PictureModels().compare(picture(), picture())
    assert measured == {"ssim": 1.0} | dict.fromkeys(MEASURES[1:])
    (tmp_path / "wrong.onnx").write_bytes(b"no model")
    with pytest.raises(ConfigError, match=r"wrong\.onnx"):
        PictureModels(lpips=tmp_path / "wrong.onnx")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ConfigError, match="--extra metrics"):
        PictureModels(lpips=tmp_path / "wrong.onnx")

"""Image measures with tiny random models in the file formats of the published ones."""

import json
import sys

import numpy as np
import pytest
from neoworld_bench.measures.image_encoders import CONFIG, ImageEncoder, LpipsModel, Preprocessing
from neoworld_bench.measures.picture_similarity import PictureModels, picture_measure
from neoworld_bench.measures.point_clouds import (
    Uni3DModel,
    coloured_points,
    farthest_points,
    grouped,
)
from neoworld_bench.measures.structural_similarity import ssim
from PIL import Image
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


def shifted(rgb, pixels=4):
    return np.roll(rgb, pixels, axis=1)


def blurred(rgb):
    return gaussian_filter(rgb, (2, 2, 0))


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    return PictureModels.load(
        clip=made.clip_folder(folder / "clip"),
        dino=made.dino_folder(folder / "dino"),
        lpips=made.lpips_file(folder / "lpips.onnx"),
        uni3d=made.uni3d_folder(folder / "uni3d"),
    )


def test_ssim_is_one_for_equal_images_and_falls_with_shift_and_blur():
    rgb = picture()
    assert ssim(rgb, rgb) == 1.0
    assert ssim(rgb, shifted(rgb, 1)) > ssim(rgb, shifted(rgb, 4)) > ssim(rgb, shifted(rgb, 12))
    assert ssim(rgb, blurred(rgb)) < 0.99
    assert ssim(rgb, blurred(rgb)) == pytest.approx(ssim(blurred(rgb), rgb), abs=1e-12)


def test_ssim_matches_scikit_image():
    # structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    # data_range=255, channel_axis=2) of scikit-image 0.26.0.
    rows, columns = np.mgrid[:20, :24]
    a = np.stack([(7 * rows + 3 * columns) % 256, rows * columns % 256, 11 * columns % 256], -1)
    a = a.astype(np.uint8)
    assert ssim(a, a[::-1]) == pytest.approx(0.217780461424, abs=1e-9)


def test_images_of_different_sizes_are_refused():
    with pytest.raises(PhotoError, match="64 x 48 and 64 x 40"):
        ssim(picture(), picture(height=40))


def test_measures_without_models_are_none_with_a_reason():
    measure = picture_measure(picture(), picture(), PictureModels.load())
    assert measure.ssim == 1.0
    assert {measure.lpips, measure.clip, measure.dino, measure.uni3d} == {None}
    assert measure.why["clip"] == "no --clip PATH" and "objects" in measure.why["uni3d"]


@needs_onnx
def test_measures_of_equal_and_degraded_images(models):
    rgb, cloud = picture(), coloured_points(block(), count=200)
    same = picture_measure(rgb, rgb, models, cloud)
    assert same.why == {}
    assert (same.clip, same.dino) == pytest.approx((1, 1), abs=1e-12) and same.lpips == 0
    assert same.uni3d is not None and -1 <= same.uni3d <= 1
    for worse in (shifted(rgb), blurred(rgb), picture(seed=1)):
        other = picture_measure(rgb, worse, models, cloud)
        assert other.clip < same.clip and other.dino < same.dino and other.lpips > 0.001
        assert other.uni3d == same.uni3d  # of the photograph and the points


@needs_onnx
def test_flat_folders_and_legacy_size_fields_are_read(tmp_path, models):
    made.image_tower(tmp_path / "vision_model.onnx")
    config = made.CLIP_CONFIG | {"size": made.SIDE, "crop_size": made.SIDE}
    (tmp_path / CONFIG).write_text(json.dumps(config))
    rgb = picture()
    expected = models.clip.embed(rgb)
    assert ImageEncoder(tmp_path, "clip").embed(rgb) == pytest.approx(expected, abs=1e-12)
    file = tmp_path / "vision_model.onnx"
    assert ImageEncoder(file, "clip").embed(rgb) == pytest.approx(expected, abs=1e-12)


def test_preprocessing_resizes_the_shorter_side_and_crops_the_center():
    plan = Preprocessing(
        size=8, crop_size=4, image_mean=(0.5, 0.5, 0.5), image_std=(0.5, 0.25, 1.0), resample=0
    )
    columns = np.repeat(np.arange(24, dtype=np.uint8), 2)
    tensor = plan.tensor(np.stack([np.tile(columns, (16, 1))] * 3, axis=-1))
    assert tensor.shape == (1, 3, 4, 4)
    # 48 x 16 becomes 24 x 8; the middle four columns are 10 to 13.
    assert tensor[0, 0, 0] == pytest.approx((np.arange(10, 14) / 255 - 0.5) / 0.5, abs=1e-6)
    assert tensor[0, 2, 3] == pytest.approx(np.arange(10, 14) / 255 - 0.5, abs=1e-6)


def _without_config(folder):
    (folder / CONFIG).unlink()


def _no_tower(folder):
    (folder / "onnx" / "vision_model.onnx").unlink()


def _damaged(folder):
    (folder / "onnx" / "vision_model.onnx").write_bytes(b"no model")


def _squashed(folder):
    config = made.CLIP_CONFIG | {"size": {"height": 32, "width": 40}}
    (folder / CONFIG).write_text(json.dumps(config))


def _uncut(folder):
    config = made.CLIP_CONFIG | {"do_center_crop": False}
    (folder / CONFIG).write_text(json.dumps(config))


def _of_another_size(folder):
    made.image_tower(folder / "onnx" / "vision_model.onnx", side=64)


def _of_text(folder):
    made.image_tower(folder / "onnx" / "vision_model.onnx", name="input_ids")


def _without_projection(folder):
    made.image_tower(folder / "onnx" / "vision_model.onnx", output="last_hidden_state")


@needs_onnx
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_without_config, "no preprocessor_config.json beside"),
        (_no_tower, "holds no onnx/vision_model.onnx or vision_model.onnx"),
        (_damaged, "vision_model.onnx is no ONNX model"),
        (_squashed, "size"),
        (_uncut, "do_center_crop is false"),
        (_of_another_size, r"shape \[any, 3, 64, 64\], not \[1, 3, 32, 32\]"),
        (_of_text, "has the inputs input_ids; expected is an image tower"),
        (_without_projection, "outputs last_hidden_state; expected is image_embeds"),
    ],
)
def test_wrong_folder_raises_one_error_with_the_expected_files(tmp_path, spoil, message):
    spoil(made.clip_folder(tmp_path))
    with pytest.raises(ConfigError, match=message) as raised:
        PictureModels.load(clip=tmp_path)
    assert str(raised.value).startswith("clip: ") or message == "size"


@needs_onnx
@pytest.mark.parametrize(
    ("scale", "message"), [(np.float32("nan"), "not finite"), (0.0, "vector of zeros")]
)
def test_damaged_weights_raise(tmp_path, scale, message):
    model = PictureModels.load(clip=made.clip_folder(tmp_path, scale=scale))
    with pytest.raises(ConfigError, match=message):
        picture_measure(picture(), picture(), model)


@needs_onnx
def test_lpips_with_fixed_size_or_other_inputs_raises(tmp_path):
    fixed = LpipsModel(made.lpips_file(tmp_path / "lpips.onnx", size=(64, 64)))
    with pytest.raises(ConfigError, match="export it with any height and width"):
        fixed.distance(picture(), picture())
    tower = made.image_tower(tmp_path / "tower.onnx")
    with pytest.raises(ConfigError, match=r"lpips: .* expected is LPIPS with two pictures"):
        LpipsModel(tower)
    with pytest.raises(ConfigError, match="there is no"):
        LpipsModel(tmp_path / "none")


@needs_onnx
def test_uni3d_with_other_inputs_raises(tmp_path):
    with pytest.raises(ConfigError, match=r"holds no points\.onnx"):
        Uni3DModel(made.clip_folder(tmp_path / "clip"))
    model = Uni3DModel(made.uni3d_folder(tmp_path / "other", width=8))
    with pytest.raises(ConfigError, match=r"gives 16 numbers and image\.onnx 8"):
        model.similarity(coloured_points(block(), count=100), picture())


@needs_onnx
def test_uni3d_depends_on_shape_and_color_but_not_position_and_size(models):
    cloud = coloured_points(block(), count=200)
    moved = cloud * [3, 3, 3, 1, 1, 1] + [1, -2, 0.5, 0, 0, 0]
    embed = models.uni3d.embed
    assert embed(moved) == pytest.approx(embed(cloud), abs=1e-5)
    assert embed(cloud) @ embed(cloud * [1, 1, 4, 1, 1, 1]) < 0.9999
    assert embed(cloud) @ embed(coloured_points(block((0.9, 0.9, 0.1)), count=200)) < 0.9999


def test_without_onnxruntime_the_error_names_the_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    (tmp_path / "lpips.onnx").write_bytes(b"")
    with pytest.raises(ConfigError, match="--extra metrics"):
        PictureModels.load(lpips=tmp_path)


def block(second=(0.1, 0.2, 0.9)):
    """A red box with a small one of another colour on it."""
    parts = [
        PartSpec(
            name="block",
            geoms=(
                GeomSpec(name="low", shape=Box(size=(0.2, 0.1, 0.1)), material="red"),
                GeomSpec(
                    name="high",
                    shape=Box(size=(0.1, 0.1, 0.05)),
                    pos=(0.0, 0.0, 0.075),
                    material="other",
                ),
            ),
        )
    ]
    materials = (
        Material(name="red", density=500.0, rgba=(0.9, 0.1, 0.1, 1.0)),
        Material(name="other", density=500.0, rgba=(*second, 1.0)),
    )
    return ObjectSpec(name="block", parts=tuple(parts), materials=materials)


def test_points_lie_on_surfaces_with_material_colors():
    cloud = coloured_points(block(), count=500)
    assert cloud.shape == (500, 6)
    low, high = cloud[:, :3].min(axis=0), cloud[:, :3].max(axis=0)
    assert low == pytest.approx((-0.1, -0.05, -0.05), abs=0.01)
    assert high == pytest.approx((0.1, 0.05, 0.1), abs=0.01)
    above = cloud[:, 2] > 0.055
    assert cloud[above, 3:] == pytest.approx(np.tile((0.1, 0.2, 0.9), (above.sum(), 1)))
    assert len(np.unique(cloud[:, 3:], axis=0)) == 2
    (part,) = block().parts
    hidden = [geom.model_copy(update={"role": "collision"}) for geom in part.geoms]
    bare = block().model_copy(update={"parts": (part.model_copy(update={"geoms": tuple(hidden)}),)})
    assert (coloured_points(bare, count=500) == cloud).all()


def test_groups_are_centred_in_the_unit_ball_with_y_and_z_exchanged():
    cloud = coloured_points(block(), count=300)
    center, features = grouped(cloud, 20, 8)
    assert center.shape == (20, 3) and features.shape == (20, 8, 6)
    assert np.linalg.norm(center, axis=1).max() == pytest.approx(1, abs=0.05)
    assert np.ptp(center, axis=0)[0] > np.ptp(center, axis=0)[1]  # x is long; up is second
    assert features[:, 0, :3] == pytest.approx(np.zeros((20, 3)), abs=1e-12)  # itself first
    line = np.column_stack([np.arange(5.0), np.zeros(5), np.zeros(5)])
    assert farthest_points(line, 4).tolist() == [0, 4, 2, 1]


@pytest.mark.parametrize(
    ("size", "mean", "std", "expected"),
    [
        (  # CLIPImageProcessor(size={"shortest_edge": 32}, crop_size={"height": 32, "width": 32})
            32,
            (0.48145466, 0.4578275, 0.40821073),
            (0.26862954, 0.26130258, 0.27577711),
            (-1.266719, -0.221305, -1.252699, 0.981439, 0.216386, 1.055725),
        ),
        (  # BitImageProcessor, which DINOv2 uses, likewise, with its own mean and deviation
            40,
            (0.485, 0.456, 0.406),
            (0.229, 0.224, 0.225),
            (-0.902046, -0.635154, 2.186841, 1.204298, 0.395984, 1.247221),
        ),
    ],
)
def test_preprocessing_matches_transformers(size, mean, std, expected):
    # Their numbers, of transformers 5.23.0 on a picture of 61 x 37 pixels.
    rows, columns = np.mgrid[:37, :61]
    rgb = np.stack([(7 * rows + 3 * columns) % 256, rows * columns % 256, 11 * columns % 256], -1)
    plan = Preprocessing(size=size, crop_size=32, image_mean=mean, image_std=std)
    t = plan.tensor(rgb.astype(np.uint8))
    own = (t[0, 0, 0, 0], t[0, 1, 15, 20], t[0, 2, 31, 31], t[0, 0, 16, 7], t.mean(), t.std())
    assert own == pytest.approx(expected, abs=2e-6)


def test_resizing_matches_pillow():
    plan = Preprocessing(size=24, crop_size=24, image_mean=(0, 0, 0), image_std=(1, 1, 1))
    rgb = picture()
    expected = np.asarray(Image.fromarray(rgb).resize((32, 24), 3))[:, 4:28] / 255
    assert plan.tensor(rgb)[0].transpose(1, 2, 0) == pytest.approx(expected, abs=1e-6)

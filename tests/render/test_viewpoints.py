"""Pictures from any camera."""

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.render import render, render_plain
from neoworld_mjx.render.scene_images import with_open_joints
from neoworld_mjx.render.view import View
from neoworld_mjx.templates import template
from tests.support import scenes


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.json"
    path.write_text(scenes.blocks().to_json())
    return path


def test_a_window_is_rendered_at_another_size_around_the_same_point():
    scene = scenes.blocks()
    camera = scene.camera
    width, height = camera.width, camera.height_px
    small = View.through(camera, (width / 2, height / 4, width, 3 * height / 4), 120)
    large = View.through(camera, (width / 2, height / 4, width, 3 * height / 4), 240)
    resized = small.resized(large.width, large.height)
    np.testing.assert_allclose(resized.centre, large.centre)
    assert small.resized(small.width, small.height) == small
    image = render(scene, small, width=large.width, height=large.height, supersample=1)
    expected = render(scene, large, supersample=1)
    assert (image.segmentation >= 0).any()
    np.testing.assert_array_equal(image.segmentation, expected.segmentation)
    plain = render_plain(scene, small, width=large.width)
    np.testing.assert_array_equal(plain, render_plain(scene, large))


def test_joints_open_by_a_fraction_of_their_range(tmp_path):
    from neoworld_mjx.config import Config
    from neoworld_mjx.view.target import open_target

    (tmp_path / "chest.py").write_text(template("drawer_cabinet").program())
    (cabinet,) = with_open_joints(open_target(tmp_path / "chest.py", Config()).after, 0.5).objects
    ranges = {joint.name: joint.upper for joint in cabinet.spec.joints}
    assert cabinet.joint_state == {name: 0.5 * upper for name, upper in ranges.items()}


def test_render_accepts_cameras(neoworld, scene_file, tmp_path):
    shots = {}
    for name, flags in {"left": ("--azimuth", 90), "right": ("--azimuth", -90)}.items():
        out = tmp_path / f"{name}.png"
        assert neoworld("render", scene_file, "--width", 60, "--out", out, *flags)[0] == 0
        shots[name] = np.asarray(Image.open(out)).astype(int)
        assert shots[name].shape == (40, 60, 3)
    assert np.abs(shots["left"] - shots["right"]).max() > 30


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--fovy", 190), "from 2 to 178"),
        (("--elevation", 91), "from -90 to 90"),
        (("--object", "nothing"), "valid are: "),
        (("--open", 2), "from 0 to 1"),
    ],
)
def test_wrong_flags_are_refused_with_one_message(neoworld, scene_file, flags, said):
    code, _, error = neoworld("render", scene_file, "--width", 48, *flags)
    assert code == 2 and said in error and len(error.strip().splitlines()) == 1

"""Pictures from any camera, turntables, and film strips of free fall."""

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.render import render, render_plain
from neoworld_mjx.render.scene_images import around, subject_points, with_open_joints
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


def test_turntable_views_show_all_points_from_one_distance():
    points = subject_points(scenes.blocks())
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    turns = np.linspace(0, 2 * np.pi, 7)
    views = around(points, turns, 0.5, width=90, height=60)
    assert np.ptp([np.linalg.norm(view.eye - centre) for view in views]) < 1e-9
    for view, turn in zip(views, turns, strict=True):
        away = view.eye - centre
        heading = away[:2] / np.linalg.norm(away[:2])
        assert np.allclose(heading, [np.cos(turn), np.sin(turn)])
        local = (points - view.eye) @ view.axes
        pixels = local[:, :2] / local[:, 2:] * view.focal + [45, 30]
        assert (pixels >= 0).all() and (pixels <= [90, 60]).all()


def test_joints_open_by_a_fraction_of_their_range(tmp_path):
    from neoworld_mjx.config import Config
    from neoworld_mjx.view.target import open_target

    (tmp_path / "chest.py").write_text(template("drawer_cabinet").program())
    (cabinet,) = with_open_joints(open_target(tmp_path / "chest.py", Config()).after, 0.5).objects
    ranges = {joint.name: joint.upper for joint in cabinet.spec.joints}
    assert cabinet.joint_state == {name: 0.5 * upper for name, upper in ranges.items()}


def test_render_accepts_cameras_and_turntables(neoworld, scene_file, tmp_path):
    shots = {}
    for name, flags in {
        "left": ("--azimuth", 90),
        "right": ("--azimuth", -90),
        "eye": ("--eye", 1, 1, 1, "--look-at", 0, 0, 0),
    }.items():
        out = tmp_path / f"{name}.png"
        assert neoworld("render", scene_file, "--width", 60, "--out", out, *flags)[0] == 0
        shots[name] = np.asarray(Image.open(out)).astype(int)
        assert shots[name].shape == (40, 60, 3)
    assert np.abs(shots["left"] - shots["right"]).max() > 30
    film = tmp_path / "turn.gif"
    flags = ("--turntable", "--frames", 3, "--width", 48, "--out", film)
    code, said, _ = neoworld("render", scene_file, *flags)
    assert code == 0 and "frames: 3" in said
    with Image.open(film) as image:
        assert (image.n_frames, image.size) == (3, (48, 32))


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--look-at", 0, 0, 0), "requires --eye"),
        (("--eye", 1, 0, 1, "--azimuth", 3), "--eye cannot be combined with --azimuth"),
        (("--eye", 1, 0, 1, "--look-at", 1, 0, 1), "the same point"),
        (("--fovy", 190), "from 2 to 178"),
        (("--elevation", 91), "from -90 to 90"),
        (("--object", "nothing"), "valid are: "),
        (("--open", 2), "from 0 to 1"),
        (("--turntable", "--frames", 1), "from 2 to 360"),
        (("--turntable", "--out", "film.mp4"), ".gif or .webp"),
        (("--turntable", "--eye", 1, 0, 1), "--turntable cannot be combined with --eye"),
    ],
)
def test_conflicting_flags_are_refused_with_one_message(neoworld, scene_file, flags, said):
    code, _, error = neoworld("render", scene_file, "--width", 48, *flags)
    assert code == 2 and said in error and len(error.strip().splitlines()) == 1

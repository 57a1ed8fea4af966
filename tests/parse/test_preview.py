"""A response is drawn and checked before it is given, as Step 1 will see it."""

import json

import numpy as np

from neoworld_mjx.mllm import Picture
from neoworld_mjx.parse.checks import AGREEMENT_ERROR, AGREEMENT_WARNING
from neoworld_mjx.parse.draw import COLOURS, draw_region
from neoworld_mjx.parse.preview import number_lines, preview
from neoworld_mjx.parse.prompts import correction_request
from neoworld_mjx.parse.schema import ParsedScene
from neoworld_mjx.render import to_png
from tests.support import answers


def exact_answer():
    """The desk, with the 2D boxes of its 3D boxes."""
    data, tree = answers.desk(), answers.exact()
    for item in data["objects"]:
        corners = tree.node(item["name"]).box2d.as_tuple()
        item["box"] = dict(zip(("left", "top", "right", "bottom"), corners, strict=True))
    return data


def entry(shown, name):
    return next(item for item in shown.objects if item["name"] == name)


def test_numbers_say_which_box_is_off_and_by_how_much():
    shown = preview(answers.photo(), json.dumps(exact_answer()))
    assert shown.issues == []
    assert entry(shown, "right")["box_iou"] == 1.0
    assert entry(shown, "right")["box"] == entry(shown, "right")["outline"]
    assert entry(shown, "can")["gap_m"] == 0.0

    data = exact_answer()
    data["objects"][2]["position"] |= {"y": 0.1, "z": 0.05}
    shown = preview(answers.photo(), json.dumps(data))
    right = entry(shown, "right")
    left_px, given_px = right["outline"][0], right["box"][0]
    assert given_px - left_px > 100  # 25 cm to the left, about 4 px a centimeter
    assert right["gap_m"] == 0.05
    assert right["box_iou"] < right["best_iou"] < 0.5
    assert entry(shown, "left")["box_iou"] == 1.0
    text = "\n".join(number_lines(shown.objects, shown.issues))
    assert f"right: box {' '.join(map(str, right['box']))}; outline" in text


def test_the_legend_and_the_class_say_what_box_iou_counts():
    data = exact_answer()
    data["objects"][2] |= {"label": "pot"}
    shown = preview(answers.photo(), json.dumps(data))
    text = "\n".join(number_lines(shown.objects, shown.issues))
    assert f"below {AGREEMENT_WARNING:g} is a warning, below {AGREEMENT_ERROR:g} an error" in text
    assert entry(shown, "right")["class"].startswith("loose")
    assert entry(shown, "can")["class"] == "round"
    assert entry(shown, "left")["yaw_deg"] == 20


def test_the_picture_shows_the_3d_boxes_and_the_fronts_of_the_response():
    shown = preview(answers.photo(), json.dumps(exact_answer()))
    data = exact_answer()
    data["objects"][1]["yaw_deg"] += 180  # The same box, with its front behind.
    turned = preview(answers.photo(), json.dumps(data))
    changed = (shown.picture.rgb != turned.picture.rgb).any(axis=-1)
    assert changed.any()
    inks = {tuple(pixel) for pixel in shown.picture.rgb[changed].tolist()}
    assert COLOURS[0] in inks  # the color of the first object


def test_a_correction_is_shown_with_what_it_keeps():
    earlier = exact_answer()
    request = correction_request(answers.photo(), ParsedScene.model_validate(earlier), ["x"])
    item = {**earlier["objects"][2], "position": {"x": 0.75, "y": 0.1, "z": 0.0}}
    text = json.dumps({"objects": [item], "removed": ["can"]})
    shown = preview(answers.photo(), text, request.prompt)
    assert [item["name"] for item in shown.objects] == ["table", "left", "right"]
    assert entry(shown, "right")["box_iou"] < 0.5
    assert entry(shown, "left")["box_iou"] == 1.0


def test_the_command_takes_the_folder_of_a_request(neoworld, tmp_path):
    (tmp_path / "1-photo.png").write_bytes(to_png(answers.photo().rgb))
    done = neoworld("preview", tmp_path)
    assert (done.returncode, "no such file; write the response first" in done.stderr) == (2, True)
    (tmp_path / "response.json").write_text(json.dumps(exact_answer()))
    done = neoworld("preview", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "can: box" in done.stdout
    assert (tmp_path / "preview.png").is_file()
    (tmp_path / "1-photo.png").unlink()
    assert "name one with --photo" in neoworld("preview", tmp_path / "response.json").stderr


def test_a_region_is_enlarged_with_rulers_in_pixels_of_the_whole():
    rgb = np.zeros((60, 80, 3), np.uint8)
    rgb[20:30, 40:50] = 200
    region = draw_region(Picture("photo", rgb), (36, 16, 54, 34))
    assert region.size == (900, 900)
    assert (region.rgb[450, 450] == 200).all()
    assert (region.rgb[100, 450] == 0).all()
    ticks = np.flatnonzero((region.rgb[0] == COLOURS[0]).all(axis=-1))
    assert set(range(0, 900, 50)) <= set(ticks.tolist())  # each pixel of the photograph
    wide = draw_region(Picture("photo", np.zeros((480, 640, 3), np.uint8)), (0, 0, 640, 480))
    assert wide.size == (900, 675)  # A region as wide as the picture is enlarged, too.
    (spots,) = np.nonzero((wide.rgb[0] == COLOURS[0]).all(axis=-1))
    assert round(600 * 900 / 640) in spots
    for box in ((-5, -5, -1, -1), (79.9, 59.9, 79.9, 59.9), (50, 40, 10, 10), (0, 0, 1e9, 1e9)):
        assert min(draw_region(Picture("photo", rgb), box).size) >= 2

import copy
import json
import math
from functools import cache

import numpy as np
import pytest
from PIL import Image, ImageDraw

from neoworld_mjx.parse.parse import CAMERA, camera_issue, edges_of
from neoworld_mjx.parse.photo import Photo
from neoworld_mjx.parse.schema import ParsedScene, to_tree
from tests.parse.test_parse import GOOD, run
from tests.support import answers

SEEN = {"pitch_deg": 35.7, "roll_deg": -1.7, "fovy_deg": 25.3, "height": 0.63}
"""The camera that took the picture."""
STATED = {"pitch_deg": 31.0, "roll_deg": -4.0, "fovy_deg": 26.0, "height": 0.58}
"""The one of the response: 4.7 degrees off, all of it called measured."""
FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (1, 3, 7, 5))
INKS = ((190, 60, 50), (70, 120, 190), (220, 190, 60), (90, 160, 90), (240, 240, 235))


def table(*, tilt=None, label="box"):
    """Five boxes on a table, as a response with the true camera."""
    places = [(0.78, 0.14), (0.95, 0.18), (0.92, -0.02), (1.02, -0.2), (0.76, -0.13)]
    sizes = [(0.06, 0.12, 0.21), (0.05, 0.09, 0.16), (0.08, 0.08, 0.2), (0.1, 0.06, 0.15)]
    boxes = [
        answers.item(f"box_{k}", (*at, 0.0), size, yaw_deg=20.0 * k, tilt=tilt, label=label)
        for k, (at, size) in enumerate(zip(places, [*sizes, (0.05, 0.07, 0.17)], strict=True))
    ]
    return answers.answer(*boxes, **SEEN)


def picture(data, *, noise=0.0):
    """Draw a response's boxes; equal responses are drawn once."""
    data, photo = _drawn(json.dumps(data), noise)
    return copy.deepcopy(data), photo


@cache
def _drawn(text, noise, finer=4):
    """Draw a response's boxes, with true 2D boxes in the response."""
    data = json.loads(text)
    tree = answers.exact(data)
    width, height = answers.SIZE
    image = Image.new("RGB", (finer * width, finer * height), (120, 90, 60))
    draw = ImageDraw.Draw(image)
    nodes = [node for node in tree.nodes if not node.environment]
    eye = tree.camera.position()
    far = lambda points: -float(np.linalg.norm(points.mean(axis=0) - eye))
    for node in sorted(nodes, key=lambda node: far(node.box3d.corners(node.base_tilt))):
        corners = node.box3d.corners(node.base_tilt)
        pixels = tree.camera.project(corners)[0] * finer
        for face, ink in sorted(
            zip(FACES, INKS, strict=True), key=lambda pair: far(corners[list(pair[0])])
        ):
            draw.polygon([tuple(pixels[k]) for k in face], fill=ink)
    pixels = np.array(image.resize(answers.SIZE, Image.Resampling.BOX), float)
    pixels += noise * np.random.default_rng(0).normal(size=pixels.shape)
    for obj in data["objects"]:
        box = tree.node(obj["name"]).box2d.as_tuple()
        obj["box"] = dict(zip(("left", "top", "right", "bottom"), box, strict=True))
    rgb = np.clip(np.rint(pixels), 0, 255).astype(np.uint8)
    return data, Photo(rgb, answers.SIZE, "0" * 64, answers.photo().path)


def tree_of(data, photo, **camera):
    data = {**data, "camera": {**data["camera"], **camera}}
    return to_tree(ParsedScene.model_validate(data), photo)


def placed_by_pixels(data, photo):
    """Return the response with the wrong camera, through which its objects are placed."""
    true = tree_of(data, photo).camera
    stated = tree_of(data, photo, **STATED).camera
    wrong = copy.deepcopy({**data, "camera": {**data["camera"], **STATED}})
    for obj in wrong["objects"][1:]:
        at = obj["position"]
        ray = stated.rays(true.project([at["x"], at["y"], 0.0])[0])
        x, y = -ray[:2] * stated.height / ray[2]
        at["x"], at["y"] = float(x), float(y)
    return wrong


@pytest.mark.parametrize("noise", [0.0, 8.0])
def test_vertical_edges_measure_pitch_and_roll(noise):
    data, photo = picture(table(), noise=noise)
    found = edges_of(photo.rgb, tree_of(data, photo, **STATED, measured=[]))
    assert found is not None
    # At the stated field of view the point at f / tan(pitch) has another pitch.
    same_point = math.tan(math.radians(35.7)) * math.tan(math.radians(25.3 / 2))
    pitch = math.degrees(math.atan(same_point / math.tan(math.radians(13.0))))
    assert math.degrees(found.pitch) == pytest.approx(pitch, abs=1.0)
    assert math.degrees(found.roll) == pytest.approx(-1.7, abs=0.5)
    assert found.pitch_sd < math.radians(1.5)
    assert found.count > 8


def test_a_wrong_camera_is_an_issue_even_if_it_was_measured():
    data, photo = picture(table())
    measured = ["pitch_deg", "height", "fovy_deg", "roll_deg"]
    issue = camera_issue(photo.rgb, tree_of(data, photo, **STATED, measured=measured))
    assert issue is not None
    assert (issue.severity, issue.node) == ("error", CAMERA)
    assert "a pitch of 35 +- 1 and a roll of -2 degrees" in issue.hint
    assert "you gave pitch 31 and roll -4" in issue.hint
    asked = camera_issue(photo.rgb, tree_of(data, photo, **STATED), already_asked=True)
    assert asked is not None
    assert asked.severity == "warning"


@pytest.mark.parametrize("change", [{"fovy_deg": 38.0}, {"fovy_deg": 15.0}, {"roll_deg": 3.0}])
def test_a_wrong_field_of_view_or_roll_is_an_issue(change):
    data, photo = picture(table())
    assert camera_issue(photo.rgb, tree_of(data, photo, **change)) is not None


@pytest.mark.parametrize("change", [{}, {"pitch_deg": 37.0}, {"fovy_deg": 26.5}, {"roll_deg": 0.0}])
def test_a_right_camera_is_none(change):
    data, photo = picture(table())
    assert camera_issue(photo.rgb, tree_of(data, photo, **change)) is None


def test_edges_of_tilted_and_of_tapered_things_do_not_vote():
    leaning, photo = picture(table(tilt={"towards": "forward", "degrees": 12.0}))
    assert edges_of(photo.rgb, tree_of(leaning, photo)) is None
    cups, photo = picture(table(label="bowl"))
    assert edges_of(photo.rgb, tree_of(cups, photo, **STATED)) is None


def test_the_model_is_asked_once():
    data, photo = picture(table())
    wrong = placed_by_pixels(data, photo)
    right = {"camera": data["camera"], "objects": []}
    parsed, names, requests = run(wrong, GOOD, right, GOOD, photo=photo)
    assert names == ["parse", "parse:judge", "parse:mend", "parse:judge"]
    assert "1. the camera: " in requests[1].prompt
    assert "- the camera: " in requests[2].prompt
    assert "the camera: " not in requests[3].prompt
    assert parsed.best_round == 1
    assert parsed.checks == ()
    # A model that insists is not asked again, although a second round is left.
    same = {"camera": {**wrong["camera"], "height": 0.6, "measured": ["fovy_deg"]}}
    parsed, names, _ = run(wrong, GOOD, same, GOOD, photo=photo, critic_rounds=2)
    assert names == ["parse", "parse:judge", "parse:mend", "parse:judge"]
    assert [issue.severity for issue in parsed.rounds[1].checks] == ["warning"]
    assert parsed.rounds[1].tree.camera_measured == ("fovy",)


@pytest.mark.parametrize("right", [True, False])
def test_measured_numbers_that_the_picture_contradicts_count_as_guesses(right):
    data, photo = picture(table())
    response = data if right else placed_by_pixels(data, photo)
    response["camera"] |= {"measured": ["pitch_deg", "fovy_deg"], "pitch_doubt_deg": 0.2}
    parsed, _, _ = run(response, critic_rounds=0, photo=photo)
    believed = (("pitch", "fovy"), pytest.approx(math.radians(0.2)))
    tree = parsed.tree
    assert (tree.camera_measured, tree.pitch_sd) == (believed if right else ((), None))


def test_objects_keep_their_pixels_if_the_camera_is_corrected():
    data, photo = picture(table())
    true = tree_of(data, photo)
    wrong = placed_by_pixels(data, photo)
    listed = copy.deepcopy(data["objects"][1])
    listed["position"]["x"] = 0.7
    right = {"camera": data["camera"], "objects": [listed]}
    parsed, _, _ = run(wrong, GOOD, right, GOOD, photo=photo)
    assert parsed.best_round == 1
    for k in range(1, 5):
        found = parsed.tree.node(f"box_{k}").box3d.position
        assert np.allclose(found, true.node(f"box_{k}").box3d.position, atol=1e-6)
    assert parsed.tree.node("box_0").box3d.position[0] == 0.7

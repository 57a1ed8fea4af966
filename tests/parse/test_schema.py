import json
import math
import re

import numpy as np
import pytest

from neoworld_mjx.errors import SpecError
from neoworld_mjx.mllm import package_text
from neoworld_mjx.mllm.requests import InvalidResponse, read_response
from neoworld_mjx.parse.checks import agreement, check_tree
from neoworld_mjx.parse.object_schema import ParsedTilt
from neoworld_mjx.parse.schema import ParsedScene, tilt_quat, to_tree
from neoworld_mjx.spec import Camera, Cues
from neoworld_mjx.spec.pose import rotate
from tests.support import answers


def tree(data, photo=None):
    return to_tree(ParsedScene.model_validate(data), photo or answers.photo())


def test_degrees_become_radians_and_shown_pixels_original_ones():
    small = answers.photo((400, 300), original=(800, 600))
    data = answers.answer(answers.item("cup", (0.8, 0.1, 0.0), yaw_deg=270))
    data["objects"][0]["box"] = {"left": 0, "top": 0, "right": 400, "bottom": 300}
    result = tree(data, small)
    assert (result.camera.width, result.camera.height_px) == (800, 600)
    assert result.camera.pitch == pytest.approx(math.radians(35))
    assert result.node("cup").box2d.as_tuple() == (20, 20, 180, 180)
    assert result.node("cup").box3d.yaw == pytest.approx(-math.pi / 2)
    assert result.node("cup").box3d.position == (0.8, 0.1, 0)


def test_boxes_are_clipped_at_the_picture_and_rejected_outside_it():
    data = answers.answer(answers.item("cup"))
    data["objects"][1]["box"] = {"left": -20, "top": 550, "right": 90, "bottom": 640}
    assert tree(data).node("cup").box2d.as_tuple() == (0, 550, 90, 600)
    data["objects"][1]["box"] = {"left": 810, "top": 550, "right": 900, "bottom": 640}
    with pytest.raises(SpecError, match=r"cup.*outside the picture.*800 x 600"):
        tree(data)


def test_cues_are_in_original_pixels_axes_and_radians():
    small = answers.photo((400, 300), original=(800, 600))
    cues = {
        "contact": {"u": 30, "v": 44},
        "cut_sides": ["bottom", "left"],
        "known_size": ["height"],
        "doubt": {"position": 0.03, "yaw_deg": 90},
    }
    data = answers.answer(answers.item("can", **cues), measured=["fovy_deg"])
    data["objects"][0]["box"] = {"left": 0, "top": 0, "right": 400, "bottom": 300}
    scene = tree(data, small)
    assert scene.camera_measured == ("fovy",)
    read = scene.node("can").cues
    assert read.contact == (60, 88)
    assert read.cut_sides == ("bottom", "left")
    assert read.known_size == ("z",)
    assert (read.position_sd, read.size_sd) == (0.03, None)
    assert read.yaw_sd == pytest.approx(math.pi / 2)
    assert scene.node("table").cues == Cues()


@pytest.mark.parametrize(
    ("towards", "top"),
    [("forward", (1, 0, 0)), ("backward", (-1, 0, 0)), ("left", (0, 1, 0)), ("right", (0, -1, 0))],
)
def test_a_tilt_moves_the_top_in_its_direction(towards, top):
    quat = tilt_quat(ParsedTilt(towards=towards, degrees=90))
    assert rotate(quat, [0, 0, 1]) == pytest.approx(np.array(top), abs=1e-12)


@pytest.mark.parametrize("yaw", [0, 50, 180])
@pytest.mark.parametrize("degrees", [20, 90, 180])
def test_the_position_of_a_tilted_object_is_the_middle_of_its_footprint(yaw, degrees):
    tilt = {"towards": "forward", "degrees": degrees}
    data = answers.answer(
        answers.item("bottle", (0.8, 0.1, 0.02), (0.06, 0.08, 0.2), yaw_deg=yaw, tilt=tilt)
    )
    node = tree(data).node("bottle")
    corners = node.box3d.corners(node.base_tilt)
    assert corners[:, 2].min() == pytest.approx(0.02)
    c, s = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
    along = corners[:, :2] @ np.array([[c, -s], [s, c]])
    middle = (along.min(axis=0) + along.max(axis=0)) / 2
    assert middle == pytest.approx(np.array([0.8 * c + 0.1 * s, -0.8 * s + 0.1 * c]))


def test_the_formula_of_the_instructions_is_that_of_the_camera():
    text = package_text("neoworld_mjx.parse", "reasoner")
    formula = re.search(
        r"A = (.*?), B = (.*?) \(without.*?\n\s+t = (.*?), x = (.*?), y = (.*?)\.\n", text
    )
    assert formula is not None
    camera = Camera(width=800, height_px=600, fovy=0.7, height=0.9, pitch=0.5, roll=0.2)
    (u, v), _ = camera.project([1.3, 0.25, 0.1])
    known = {
        "a": (u - 400) / camera.focal, "b": (v - 300) / camera.focal, "height": 0.9, "z": 0.1,
        "cos_r": math.cos(0.2), "sin_r": math.sin(0.2),
        "cos_p": math.cos(0.5), "sin_p": math.sin(0.5),
    }  # fmt: skip
    for name, expression in zip(("A", "B", "t", "x", "y"), formula.groups(), strict=True):
        code = re.sub(r"(sin|cos) ([rp])", r"\1_\2", expression)
        code = re.sub(r"(?<=[\w)]) (?=[\w(])", " * ", code)
        known[name] = eval(code, {}, known)
    assert (known["x"], known["y"]) == pytest.approx((1.3, 0.25))


def test_all_numbers_and_names_out_of_bounds_are_reported_at_once():
    bad = answers.answer(
        answers.item("2nd", size=(0.1, 0.0, 0.1)),
        answers.item("world"),
        answers.item("can", articulation=[{"part": "../lid", "motion": "revolute", "opening": 3}]),
        fovy_deg=400,
    )
    with pytest.raises(InvalidResponse) as error:
        read_response(json.dumps(bad), ParsedScene)
    for part in (
        r"objects\.1\.name: .*a name has letters",
        r"objects\.1\.size\.width: .*must lie in 0\.0001 \.\. 1000, got 0",
        r"objects\.2\.name: .*reserves this name",
        r"objects\.3\.articulation\.0\.part: .*a name has letters",
        r"objects\.3\.articulation\.0\.opening: .*must lie in 0 \.\. 1, got 3",
        r"camera\.fovy_deg: .*must lie in",
    ):
        assert re.search(part, str(error.value)), part


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"parent": "cup"}, "cycle"),
        ({"parent": None}, "cup has no parent"),
        ({"name": "table"}, "repeated: table"),
        ({"name": "Table"}, "table differs by case alone"),
        ({"parent": "tabel"}, "cup: parent 'tabel' is not a node"),
        ({"occluded_by": ["dog"]}, "cup: occluded_by 'dog' is not a node"),
        ({"parent_link": "drawer"}, "cup: parent_link 'drawer' .* has no movable parts"),
    ],
)
def test_the_tree_is_validated_with_the_response(change, said):
    data = answers.answer(answers.item("cup") | change)
    with pytest.raises(InvalidResponse, match=said):
        read_response(json.dumps(data), ParsedScene)


def test_the_example_of_the_instructions_is_valid():
    guide = package_text("neoworld_mjx.parse", "reasoner")
    example = guide[guide.index('    {"observations"') : guide.index("And a cabinet")]
    result = to_tree(read_response(example, ParsedScene), answers.photo())
    assert all(agreement(result, node) > 0.7 for node in result.nodes)
    assert check_tree(result) == ()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"relation": "leaning", "leans_on": "wall"}, "leans_on 'wall' is not a node"),
        ({"relation": "leaning", "leans_on": "table"}, "not itself or what it stands on"),
        ({"leans_on": "cup"}, "leans_on is for the relation leaning only"),
    ],
)
def test_what_an_object_leans_on_is_checked(change, message):
    data = answers.answer(answers.item("cup"), answers.item("book") | change)
    with pytest.raises(InvalidResponse, match=message):
        read_response(json.dumps(data), ParsedScene)


def test_what_an_object_leans_on_reaches_the_tree():
    leaning = {"relation": "leaning", "leans_on": "cup"}
    data = answers.answer(answers.item("cup"), answers.item("book") | leaning)
    assert tree(data).node("book").leans_on == "cup"
    assert tree(data).node("cup").leans_on is None

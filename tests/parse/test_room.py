"""Supports of the room in an answer: outlines."""

import numpy as np
import pytest
from pydantic import ValidationError

from neoworld_mjx.parse.checks import check_tree
from neoworld_mjx.parse.crops import support_colours
from neoworld_mjx.parse.photo import Photo
from neoworld_mjx.parse.schema import ParsedScene, to_tree
from neoworld_mjx.program.supports import MATERIALS
from neoworld_mjx.spec import Box2D, SceneTree
from tests.support import answers

L_SHAPE = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (0.0, 0.5), (0.0, 0.0), (-0.5, 0.0)]


def points(corners):
    return [{"x": x, "y": y} for x, y in corners]


def polygon(*corners):
    return {"shape": "polygon", "points": points(corners)}


def parsed(outline, *objects) -> SceneTree:
    data = {"camera": answers.answer()["camera"]}
    data["objects"] = [answers.table(outline=outline), *objects]
    return to_tree(ParsedScene.model_validate(data), answers.photo())


def test_a_polygon_runs_anticlockwise_and_fills_its_box():
    clockwise = [(x * 1.02, y) for x, y in L_SHAPE[::-1]]
    node = parsed(polygon(*clockwise)).node("table")
    corners = node.outline.corners()
    assert corners.min(axis=0) == pytest.approx([-0.5, -0.5])
    assert corners.max(axis=0) == pytest.approx([0.5, 0.5])
    x, y = corners.T
    assert np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2 == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("outline", "words"),
    [
        (polygon(*L_SHAPE[:2]), "3 to 24 points, got 2"),
        (polygon(*L_SHAPE * 5), "at most 24 items"),
        ({"shape": "round", "points": points(L_SHAPE)}, "round has no points"),
        (
            polygon((-0.5, -0.5), (0.5, 0.5), (0.5, -0.5), (-0.5, 0.5)),
            "edges from points 0 and 2",
        ),
        (
            polygon((-0.5, -0.5), (0.5, -0.5), (0.5, -0.499), (-0.5, 0.5)),
            "points 1 and 2 are the same",
        ),
        (polygon((-0.5, -0.5), (0.5, 0.48), (0.5, 0.5), (-0.5, -0.48)), "encloses 0.0"),
        (polygon(*((x / 2, y) for x, y in L_SHAPE)), r"reaches x -0.25 .. 0.25 and y -0.5 .. 0.5"),
        (polygon(*((x * 2, y) for x, y in L_SHAPE)), "points.0.0"),
    ],
)
def test_a_bad_outline_is_refused_by_name_and_reason(outline, words):
    with pytest.raises(ValidationError, match=f"(?s)objects.0\n.*{words}"):
        parsed(outline)


def test_the_cut_off_corner_of_an_outline_supports_nothing():
    """The table of 1.6 m reaches from x 0.2 to 1.8 and from y -0.8 to 0.8."""
    corner = answers.item("left", (0.4, 0.6, 0.0), (0.1, 0.1, 0.1))
    middle = answers.item("right", (0.9, -0.2, 0.0), (0.1, 0.1, 0.1))

    def outside(outline):
        issues = check_tree(parsed(outline, corner, middle))
        return [issue.node for issue in issues if issue.code == "footprint"]

    assert outside(None) == []
    assert outside(polygon(*L_SHAPE)) == ["left"]
    rim = answers.item("rim", (0.3, 0.7, 0.0), (0.1, 0.1, 0.1))
    issues = check_tree(parsed({"shape": "round"}, rim, middle))
    assert [i.node for i in issues if i.code == "footprint"] == ["rim"]


SURFACE = {
    "material": "wood",
    "pattern": "boards",
    "colour": [0.8, 0.6, 0.3],
    "second_colour": [0.4, 0.3, 0.15],
    "step": 0.09,
    "run": "along_width",
}


def table_with(surface, photo=None) -> SceneTree:
    data = answers.answer(answers.item("can", (0.8, 0.0, 0.0)))
    data["objects"][0]["surface"] = surface
    return to_tree(ParsedScene.model_validate(data), photo or answers.photo())


def test_a_surface_becomes_a_named_material_with_a_pattern():
    surface = table_with(SURFACE).node("table").surface
    assert surface is not None and surface.material == "wood" and surface.material in MATERIALS
    assert surface.rgb == (0.8, 0.6, 0.3)
    pattern = surface.pattern
    assert (pattern.kind, pattern.step, pattern.along) == ("boards", 0.09, "y")
    assert pattern.rgb == (0.4, 0.3, 0.15)
    assert table_with(None).node("table").surface is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"colour": [0.5, 0.5]}, r"surface.colour\n.*must be three numbers, got 2"),
        ({"second_colour": [0.5, 0.5, 90]}, r"second_colour.2\n.*must lie in 0 .. 1, got 90"),
        ({"step": 0}, r"surface.step\n.*must lie in 0.0001 .. 10, got 0"),
        ({"material": "cheese"}, "material"),
    ],
)
def test_a_bad_surface_is_refused_by_name(change, words):
    with pytest.raises(ValidationError, match=words):
        table_with(SURFACE | change)


def painted(tree, table=(200, 150, 60), other=(20, 30, 200)) -> Photo:
    """Paint the table's pixels in one colour, the can's box and the rest in another."""
    rgb = np.full((600, 800, 3), other, np.uint8)
    rays = tree.camera.rays(np.stack(np.meshgrid(np.arange(800), np.arange(600)), -1) + 0.5)
    on = measured_reach(tree, rays)
    rgb[on] = table
    x0, y0, x1, y1 = (round(v) for v in tree.node("can").box2d.as_tuple())
    rgb[y0:y1, x0:x1] = other
    return Photo(rgb, (800, 600), "0" * 64, answers.photo().path)


def measured_reach(tree, rays):
    eye, box = tree.camera.position(), tree.node("table").box3d
    t = (box.position[2] + box.size[2] - eye[2]) / np.where(rays[..., 2] < -1e-9, rays[..., 2], -1)
    at = eye + t[..., None] * rays
    inside = np.abs(at[..., :2] - box.position[:2]) < np.array(box.size[:2]) / 2
    return inside.all(axis=-1) & (rays[..., 2] < 0)


def test_colours_are_measured_where_the_photo_shows_the_support_alone():
    tree = table_with(SURFACE)
    # A narrow table, so that most of the picture and of the table's own box shows something else.
    tree = answers.moved(tree, "table", size=(0.25, 0.25, 1.0), position=(-0.2, 0, 0))
    tree = answers.with_node(tree, "can", box2d=Box2D(x0=350, y0=250, x1=450, y1=330))
    colour = support_colours(painted(tree), tree)["table"]
    assert colour.source == "photo"
    assert colour.rgb == pytest.approx(np.array([200, 150, 60]) / 255)
    assert 0.01 < colour.share < 0.3


def test_the_parsed_colour_is_used_where_the_photo_hardly_shows_the_support():
    tree = table_with(SURFACE)
    covered = answers.with_node(tree, "can", box2d=Box2D(x0=0, y0=0, x1=800, y1=590))
    photo = painted(tree)
    assert support_colours(photo, covered)["table"] == ((0.8, 0.6, 0.3), "answer", 0.0)
    plain = table_with({"material": "stone"})
    plain = answers.with_node(plain, "can", box2d=covered.node("can").box2d)
    assert support_colours(photo, plain)["table"] == (None, "material", 0.0)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"furniture": True}, "node can has furniture, which only an environment support"),
        (
            {"furniture": True, "environment": True, "outline": {"shape": "round"}},
            "furniture is built from the picture; leave outline null",
        ),
    ],
)
def test_contradictory_furniture_is_rejected(fields, words):
    with pytest.raises(ValidationError, match=words):
        parsed(None, answers.item("can", **fields))

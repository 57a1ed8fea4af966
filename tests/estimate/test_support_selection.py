import numpy as np
import pytest

from neoworld_mjx.estimate.refit import refit_tree, surface_of
from neoworld_mjx.spec import Box, Box2D, HollowBox
from tests.support import answers, scenes

TRAY, BENCH = (0.24, 0.3, 0.05), (0.3, 0.3, 0.12)
SHAPES = {
    "tray": scenes.single("tray", (HollowBox(size=TRAY, wall=0.01), (0, 0, 0.025))),
    "bench": scenes.single(
        "bench",
        (Box(size=(0.3, 0.3, 0.02)), (0, 0, 0.11)),
        (Box(size=(0.3, 0.02, 0.1)), (0, 0.14, 0.05)),
        (Box(size=(0.3, 0.02, 0.1)), (0, -0.14, 0.05)),
    ),
    "brick": scenes.single("brick", (Box(size=(0.2, 0.1, 0.06)), (0, 0, 0.03))),
    "cube": scenes.single("cube", (Box(size=(0.06, 0.06, 0.06)), (0, 0, 0.03))),
}


def photographed(*items):
    """The true tree of things, with the boxes of their built shapes, and these shapes."""
    tree = answers.exact(answers.answer(*items))
    for node in tree.nodes:
        if node.environment:
            continue
        points = surface_of(SHAPES[node.name], node).hull + np.array(node.box3d.position)
        pixels, _ = tree.camera.project(points)
        corners = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
        box = Box2D(**dict(zip(("x0", "y0", "x1", "y1"), corners, strict=True)))
        tree = answers.with_node(tree, node.name, box2d=box)
    return tree, {node.name: SHAPES[node.name] for node in tree.nodes if not node.environment}


def cube(x, y, z, **extra):
    return answers.item("cube", (x, y, z), (0.06, 0.06, 0.06), **extra)


def tray():
    return answers.item("tray", (0.85, 0, 0), TRAY)


def on_table(tree):
    """The same as an answer that stands the cube on the table."""
    x, y, _ = tree.node("cube").box3d.position
    box = tree.node("cube").box3d.model_copy(update={"position": (x, y, 0.0)})
    return answers.with_node(tree, "cube", parent="table", relation="on", box3d=box)


@pytest.mark.parametrize(
    ("below", "z", "relation"),
    [(tray(), 0.01, "in"), (answers.item("brick", (0.85, 0, 0), (0.2, 0.1, 0.06)), 0.06, "on")],
)
def test_an_object_in_or_on_another_one_is_not_on_the_table(below, z, relation):
    truth, shapes = photographed(below, cube(0.85, 0, z, parent=below["name"], relation=relation))
    fitted, report = refit_tree(on_table(truth), shapes)
    node = fitted.node("cube")
    assert (node.parent, node.relation) == (below["name"], relation)
    assert node.box3d.position == pytest.approx((0.85, 0, z), abs=0.005)
    assert "cube" in report.to_json()["carriers"]
    assert "on table" in report.supports["cube"].phrase()


def test_an_object_far_from_its_parsed_support_is_on_the_object_below_it():
    brick = answers.item("brick", (0.8, -0.3, 0), (0.2, 0.1, 0.06))
    truth, shapes = photographed(tray(), brick, cube(0.85, 0, 0.01, parent="tray", relation="in"))
    wrong = answers.with_node(truth, "cube", parent="brick", relation="on")
    fitted, _ = refit_tree(wrong, shapes)
    assert (fitted.node("cube").parent, fitted.node("cube").relation) == ("tray", "in")


@pytest.mark.parametrize(
    "things",
    [
        (tray(), cube(0.69, 0, 0)),  # before it
        (tray(), cube(1.02, 0, 0)),  # behind it
        (answers.item("bench", (0.85, 0, 0), BENCH), cube(0.75, 0, 0)),  # under it
        (tray(), cube(0.85, 0, 0.01, parent="tray", relation="in")),
    ],
)
def test_a_correct_support_stays(things):
    truth, shapes = photographed(*things)
    answer = answers.moved(truth, "cube", (0.02, 0.01, 0.0))
    fitted, report = refit_tree(answer, shapes)
    assert report.supports == {}
    assert fitted.node("cube").parent == truth.node("cube").parent


def test_supports_stay_on_request():
    truth, shapes = photographed(tray(), cube(0.85, 0, 0.01, parent="tray", relation="in"))
    fitted, report = refit_tree(on_table(truth), shapes, change_supports=False)
    assert fitted.node("cube").parent == "table"
    assert report.supports == {}

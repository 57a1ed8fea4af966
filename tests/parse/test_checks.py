import numpy as np
import pytest

from neoworld_mjx.parse.checks import (
    REACH,
    agreement,
    best_agreement,
    check_score,
    check_tree,
)
from neoworld_mjx.parse.outlines import expected_box, hidden_sides
from neoworld_mjx.spec import Box2D
from tests.support import answers


def codes(tree, name=None):
    return {f.code: f for f in check_tree(tree) if name in (None, f.node)}


def test_a_consistent_parse_has_no_findings_and_a_full_score():
    tree = answers.exact()
    assert check_tree(tree) == ()
    assert check_score(tree, ()) == pytest.approx(1, abs=1e-6)


def test_a_projection_error_states_its_direction():
    tree = answers.moved(answers.exact(), "right", position=(0.0, -0.2, 0.0))
    result = codes(tree, "right")["projection"]
    assert result.value == pytest.approx(best_agreement(tree, tree.node("right")))
    assert "too far right" in result.hint
    missing = answers.moved(answers.exact(), "right", position=(0.0, -0.5, 0.0))
    assert codes(missing, "right")["projection"].severity == "error"


@pytest.mark.parametrize("direction", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_place_within_reach_is_no_issue(direction, sign):
    """Step 4 corrects it along the view and across it; along the view, so do supports."""
    tree = answers.exact()
    camera, box = tree.camera, tree.node("right").box3d
    ways = [box.corners().mean(axis=0) - camera.position(), *camera.axes()[:, :2].T]
    way = ways[direction] / np.linalg.norm(ways[direction])
    distance = np.linalg.norm(ways[0])
    near, far = (
        answers.moved(tree, "right", position=tuple(sign * share * REACH * distance * way))
        for share in (0.8, 5)
    )
    assert best_agreement(near, near.node("right")) > 0.9
    assert "projection" not in codes(near, "right")
    assert direction > 0 or not codes(near, "right")
    # Only much farther along the view does the apparent size, which may be wrong, matter.
    assert codes(far, "right").keys() & {"projection", "gap_m"}


def test_a_wrong_size_is_an_issue_at_any_place():
    tree = answers.moved(answers.exact(), "right", size=(1.8, 1.8, 1.8))
    assert "projection" in codes(tree, "right")
    thin = answers.moved(answers.exact(), "right", size=(1, 1, 2.5))
    assert "high" in codes(thin, "right")["projection"].hint


def test_sizes_are_compared_with_the_category():
    small = answers.moved(answers.exact(), "can", size=(3.5, 3.5, 3.5))
    result = codes(small, "can")["size_m"]
    assert (result.severity, result.threshold) == ("warning", 0.35)
    huge = answers.moved(answers.exact(), "can", size=(9, 9, 9))
    assert codes(huge, "can")["size_m"].severity == "error"
    tiny = answers.moved(answers.exact(), "can", size=(0.1, 0.1, 0.1))
    assert "small" in codes(tiny, "can")["size_m"].hint


@pytest.mark.parametrize(
    ("height", "word", "severity"),
    [(0.1, "floats", "warning"), (0.4, "floats", "error"), (-0.2, "below", "error")],
)
def test_floating_and_sunken_objects(height, word, severity):
    tree = answers.moved(answers.exact(), "right", position=(0, 0, height))
    result = codes(tree, "right")["gap_m"]
    assert word in result.hint
    assert result.severity == severity
    assert result.value == pytest.approx(abs(height) - (0.03 if word == "below" else 0))
    slight = answers.moved(answers.exact(), "right", position=(0, 0, 0.05))
    assert "gap_m" not in codes(slight, "right")


def test_an_object_may_stand_in_a_hollow_but_not_in_a_table():
    tree = answers.exact()
    assert "gap_m" not in codes(answers.moved(tree, "can", position=(0, 0, -0.06)), "can")
    thick = answers.moved(answers.moved(tree, "table", position=(0, 0, -0.07)), "table", None)
    box = thick.node("table").box3d.model_copy(update={"size": (1.6, 1.6, 0.1)})
    thick = answers.with_node(thick, "table", box3d=box)
    sunk = answers.moved(thick, "right", position=(0, 0, -0.08))
    assert "sunk into table" in codes(sunk, "right")["gap_m"].hint


def test_footprints_lie_in_that_of_the_support():
    tree = answers.exact()
    box = tree.node("can").box3d
    assert "footprint" not in codes(answers.moved(tree, "can", position=(0.05, 0, 0)), "can")
    # The picture shows it over its support, or beside it.
    beside = answers.moved(tree, "can", position=(0, 0.12, 0))
    assert "footprint" not in codes(beside, "can")
    x0, y0, x1, y1 = expected_box(beside.camera, beside.node("can")).tolist()
    shown = answers.with_node(beside, "can", box2d=Box2D(x0=x0, y0=y0, x1=x1, y1=y1))
    assert codes(shown, "can")["footprint"].value < 0.6
    ahead = answers.moved(tree, "can", position=(0.15, 0.03, 0))
    assert "footprint" not in codes(ahead, "can")
    far = codes(answers.moved(tree, "can", position=(0.3, 0, 0)), "can")["footprint"]
    assert (far.value, far.severity) == (0, "error")
    assert box.size[2] == 0.12


def test_attached_objects_reach_their_support():
    tree = answers.with_node(answers.exact(), "can", relation="attached")
    assert "attached" not in codes(tree, "can")
    off = answers.moved(tree, "can", position=(0, 0, 0.1))
    assert codes(off, "can")["attached"].severity == "error"


def test_overlapping_objects_and_duplicates():
    tree = answers.exact()
    left = tree.node("left").box3d
    same = answers.with_node(tree, "right", box3d=left, box2d=tree.node("left").box2d)
    result = codes(same, "right")
    assert result["overlap"].value == pytest.approx(1)
    assert result["twice"].value == pytest.approx(1)
    # What stands in its carrier shares its space by right.
    within = answers.moved(tree, "can", position=(0, 0, -0.07))
    assert "overlap" not in codes(within)


@pytest.mark.parametrize(
    ("label", "size", "told"),
    [
        ("small dish", 0.065, False),
        ("pot lid", 0.09, False),
        ("bamboo rack", 0.14, False),
        ("floor globe", 1.1, False),
        ("small metal tray", 0.065, False),
        ("figurine", 0.11, False),
        ("dish", 0.02, True),
        ("globe", 3.5, True),
    ],
)
def test_usual_sizes_are_no_findings(label, size, told):
    tree = answers.with_node(answers.exact(), "can", label=label)
    box = tree.node("can").box3d.model_copy(update={"size": (size, size, size / 2)})
    assert ("size_m" in codes(answers.with_node(tree, "can", box3d=box), "can")) == told


def test_hidden_sides_do_not_lower_the_agreement():
    tree = answers.exact()
    node = tree.node("right")
    x0, y0, x1, y1 = node.box2d.as_tuple()
    half = Box2D(x0=(x0 + x1) / 2, y0=y0, x1=x1, y1=y1)
    seen = answers.with_node(tree, "right", box2d=half)
    assert agreement(seen, seen.node("right")) == pytest.approx(0.5, abs=1e-6)
    hider = Box2D(x0=x0 - 20, y0=y0 - 10, x1=(x0 + x1) / 2, y1=y1 + 10)
    hidden = answers.with_node(seen, "left", box2d=hider)
    hidden = answers.with_node(hidden, "right", occluded=True, occluded_by=("left",))
    assert hidden_sides(hidden, hidden.node("right")).tolist() == [True, False, False, False]
    assert agreement(hidden, hidden.node("right")) == pytest.approx(1, abs=1e-6)
    # The box must still lie within what is expected.
    beyond = answers.with_node(hidden, "right", box2d=half.model_copy(update={"x1": x1 + 60}))
    assert agreement(beyond, beyond.node("right")) < 0.8
    cut = answers.with_node(tree, "right", box2d=Box2D(x0=0, y0=y0, x1=x1, y1=y1))
    assert hidden_sides(cut, cut.node("right")).tolist() == [True, False, False, False]

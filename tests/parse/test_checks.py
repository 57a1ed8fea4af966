import math

import numpy as np
import pytest

from neoworld_mjx.parse.checks import agreement, check_score, check_tree, hidden_sides
from neoworld_mjx.spec import Box2D, PartState
from tests.support import answers


def codes(tree, name=None):
    return {f.code: f for f in check_tree(tree) if name in (None, f.node)}


def test_a_consistent_parse_has_no_findings_and_a_full_score():
    tree = answers.exact()
    assert check_tree(tree) == ()
    assert check_score(tree, ()) == pytest.approx(1, abs=1e-6)


def test_a_box_that_projects_elsewhere_is_told_where():
    tree = answers.moved(answers.exact(), "right", position=(0.0, -0.08, 0.0))
    found = codes(tree, "right")["projection"]
    assert found.value == pytest.approx(agreement(tree, tree.node("right")))
    assert "too far right" in found.hint
    gone = answers.moved(answers.exact(), "right", position=(0.0, -0.5, 0.0))
    assert codes(gone, "right")["projection"].severity == "error"


def test_a_label_is_held_against_sizes():
    small = answers.moved(answers.exact(), "can", size=(3.5, 3.5, 3.5))
    found = codes(small, "can")["size_m"]
    assert (found.severity, found.threshold) == ("warning", 0.35)
    huge = answers.moved(answers.exact(), "can", size=(9, 9, 9))
    assert codes(huge, "can")["size_m"].severity == "error"
    tiny = answers.moved(answers.exact(), "can", size=(0.1, 0.1, 0.1))
    assert "small" in codes(tiny, "can")["size_m"].hint


@pytest.mark.parametrize(
    ("height", "word", "severity"),
    [(0.05, "floats", "warning"), (0.4, "floats", "error"), (-0.2, "below", "error")],
)
def test_floating_and_sunken_things(height, word, severity):
    tree = answers.moved(answers.exact(), "right", position=(0, 0, height))
    found = codes(tree, "right")["gap_m"]
    assert word in found.hint
    assert found.severity == severity
    assert found.value == pytest.approx(abs(height) - (0.03 if word == "below" else 0))


def test_a_thing_may_stand_in_a_hollow_but_not_in_a_table():
    tree = answers.exact()
    assert "gap_m" not in codes(answers.moved(tree, "can", position=(0, 0, -0.06)), "can")
    thick = answers.moved(answers.moved(tree, "table", position=(0, 0, -0.07)), "table", None)
    box = thick.node("table").box3d.model_copy(update={"size": (1.6, 1.6, 0.1)})
    thick = answers.with_node(thick, "table", box3d=box)
    sunk = answers.moved(thick, "right", position=(0, 0, -0.05))
    assert "sunk into table" in codes(sunk, "right")["gap_m"].hint


def test_footprints_lie_in_that_of_the_carrier():
    tree = answers.exact()
    box = tree.node("can").box3d
    assert "footprint" not in codes(answers.moved(tree, "can", position=(0.05, 0, 0)), "can")
    off = codes(answers.moved(tree, "can", position=(0.1, 0, 0)), "can")["footprint"]
    assert off.value < 0.6
    far = codes(answers.moved(tree, "can", position=(0.3, 0, 0)), "can")["footprint"]
    assert (far.value, far.severity) == (0, "error")
    assert box.size[2] == 0.12


def test_flags():
    tree = answers.exact()
    door = (PartState(part="door", type="revolute"),)
    assert "environment" in codes(answers.with_node(tree, "table", articulation=door), "table")
    assert "environment" in codes(answers.with_node(tree, "left", label="wall"), "left")
    apart = answers.with_node(tree, "can", occluded=True, occluded_by=("right",))
    assert "right cannot hide it" in codes(apart, "can")["occluded_by"].hint
    unsaid = answers.with_node(tree, "can", occluded=True)
    assert codes(unsaid, "can")["occluded_by"].threshold == 1


def test_hanging_things_reach_what_they_hang_on():
    tree = answers.with_node(answers.exact(), "can", relation="attached")
    assert "attached" not in codes(tree, "can")
    off = answers.moved(tree, "can", position=(0, 0, 0.1))
    assert codes(off, "can")["attached"].severity == "error"


def test_two_things_in_one_place_and_one_thing_listed_twice():
    tree = answers.exact()
    left = tree.node("left").box3d
    same = answers.with_node(tree, "right", box3d=left, box2d=tree.node("left").box2d)
    found = codes(same, "right")
    assert found["overlap"].value == pytest.approx(1)
    assert found["twice"].value == pytest.approx(1)
    # What stands in its carrier shares its space by right.
    within = answers.moved(tree, "can", position=(0, 0, -0.07))
    assert "overlap" not in codes(within)


def test_sides_behind_an_occluder_or_at_the_edge_are_not_held_against_the_box():
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


def test_findings_phrase_number_and_bound():
    tree = answers.moved(answers.exact(), "right", position=(0, 0, 0.4))
    said = codes(tree, "right")["gap_m"].phrase()
    assert said == "right: it floats above table by 0.4 m [gap_m 0.4, bound 0.018]"
    scores = [
        check_score(t, check_tree(t))
        for t in (
            answers.exact(),
            answers.moved(answers.exact(), "right", position=(0.05, 0, 0)),
            tree,
        )
    ]
    assert scores == sorted(scores, reverse=True)
    assert np.ptp(scores) > 0.1
    assert not math.isnan(scores[2])

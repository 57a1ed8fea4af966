import math
import time

import numpy as np
import pytest

from neoworld_mjx.measure import parse_measure
from neoworld_mjx.parse.checks import agreement
from neoworld_mjx.parse.fit import fit_tree
from neoworld_mjx.spec import Box2D, SceneTree
from tests.support import answers


def disturbed(tree, seed, *, place=0.04, size=0.06, yaw=8.0, pitch=3.0, height=0.05):
    """The tree with errors as models make them; 2D boxes stay exact."""
    rng = np.random.default_rng(seed)
    camera = tree.camera
    camera = camera.model_copy(
        update={
            "pitch": camera.pitch + math.radians(pitch * rng.choice([-1, 1])),
            "height": camera.height * math.exp(height * rng.normal()),
        }
    )
    wrong = SceneTree(camera=camera, nodes=tree.nodes)
    for node in tree.nodes:
        if not node.environment:
            wrong = answers.moved(
                wrong,
                node.name,
                (*rng.normal(0, place, 2), 0.0),
                np.exp(size * rng.normal(size=3)),
                yaw * rng.normal(),
            )
    return wrong


def mean_agreement(tree):
    things = [node for node in tree.nodes if not node.environment]
    return float(np.mean([agreement(tree, node) for node in things]))


def test_a_consistent_parse_stays_as_it_was():
    tree = answers.exact()
    fitted, report = fit_tree(tree)
    assert fitted is tree
    assert not report.applied
    assert "under 0.01" in report.reason
    assert report.agreement_before == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_errors_as_models_make_them_shrink(seed):
    truth = answers.exact()
    wrong = disturbed(truth, seed)
    fitted, report = fit_tree(wrong)
    assert report.applied
    assert report.agreement_after == pytest.approx(mean_agreement(fitted))
    assert mean_agreement(fitted) > 0.95 > mean_agreement(wrong)
    before, after = parse_measure(wrong, truth), parse_measure(fitted, truth)
    assert after.iou_3d_scaled.value > before.iou_3d_scaled.value
    # Boxes in the picture, names and the hierarchy are what was seen: they do not move.
    assert [n.box2d for n in fitted.nodes] == [n.box2d for n in wrong.nodes]
    assert fitted.node("table") == wrong.node("table")


def test_it_says_how_far_everything_moved():
    truth = answers.exact()
    wrong = answers.moved(truth, "right", position=(0.05, 0.03, 0))
    fitted, report = fit_tree(wrong)
    moved = report.objects["right"]
    a, b = (np.array(t.node("right").box3d.position) for t in (wrong, fitted))
    assert moved.distance_m == pytest.approx(np.linalg.norm(a - b))
    assert moved.distance_m == pytest.approx(np.hypot(0.05, 0.03), abs=0.02)
    assert moved.agreement_before < 0.7 < moved.agreement_after
    assert report.pitch_deg == pytest.approx(math.degrees(fitted.camera.pitch - wrong.camera.pitch))
    data = report.to_json()
    assert data["applied"] is True
    assert set(data["objects"]) == {"left", "right", "can"}


def test_contacts_hold_and_floating_things_come_down():
    wrong = answers.moved(answers.exact(), "right", position=(0, 0, 0.06))
    fitted, report = fit_tree(wrong)
    assert report.applied
    assert abs(fitted.node("right").box3d.position[2]) < 0.01
    left, can = fitted.node("left").box3d, fitted.node("can").box3d
    assert can.position[2] == pytest.approx(left.position[2] + left.size[2], abs=0.006)


def test_hidden_sides_do_not_shrink_a_thing():
    truth = answers.exact()
    x0, y0, x1, y1 = truth.node("right").box2d.as_tuple()
    seen = answers.with_node(
        truth,
        "right",
        box2d=Box2D(x0=x0, y0=y0, x1=x1, y1=y0 + 0.6 * (y1 - y0)),
        occluded=True,
        occluded_by=("left",),
    )
    seen = answers.with_node(
        seen, "left", box2d=Box2D(x0=x0 - 5, y0=y0 + 0.6 * (y1 - y0) - 2, x1=x1 + 5, y1=y1 + 40)
    )
    wrong = answers.moved(seen, "right", position=(0.04, 0.02, 0))
    fitted, _ = fit_tree(wrong)
    was, now = wrong.node("right").box3d.size, fitted.node("right").box3d.size
    assert np.allclose(was, now, rtol=0.12)
    assert agreement(fitted, fitted.node("right")) > 0.9


def test_it_never_makes_the_reprojection_worse():
    """Also of boxes that no camera could have seen so."""
    rng = np.random.default_rng(5)
    for _ in range(2):
        tree = answers.exact()
        for name in ("left", "right", "can"):
            at = rng.uniform(0, 500, 2)
            span = rng.uniform(5, 200, 2)
            box = Box2D(x0=at[0], y0=at[1], x1=at[0] + span[0], y1=at[1] + span[1])
            tree = answers.with_node(tree, name, box2d=box)
        fitted, report = fit_tree(tree)
        assert mean_agreement(fitted) >= mean_agreement(tree)
        assert report.applied or fitted is tree


def test_a_parse_of_supports_alone_has_nothing_to_fit():
    tree = answers.exact(answers.answer())
    fitted, report = fit_tree(tree)
    assert fitted is tree
    assert "no object" in report.reason


def test_twenty_objects_are_fitted_in_seconds():
    items = [
        answers.item(f"b{k}", (0.6 + 0.12 * (k % 5), 0.18 * (k // 5 - 1.5), 0), (0.06, 0.08, 0.05))
        for k in range(20)
    ]
    wrong = disturbed(answers.exact(answers.answer(*items)), 3, place=0.02)
    begun = time.perf_counter()
    _, report = fit_tree(wrong)
    assert report.applied
    assert time.perf_counter() - begun < 20

"""Unnecessary moves of the search are reverted."""

import equinox as eqx
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.physics.exact import snap_exactly
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.physics.scene_arrays import pad_scene
from neoworld_mjx.refinement.choosing import Chosen
from neoworld_mjx.refinement.reverting import (
    NOISE,
    PhotoAgreement,
    _accepted,
    _placed_agreement,
    revert_moves,
)
from tests.support.scenes import stored_scene

OPTIONS = RefineOptions(check_duration_s=0.3)


def winner(model, xy):
    layout = Layout.zero(1, len(model.names))
    layout = eqx.tree_at(lambda z: z.xy, layout, np.asarray(xy, np.float32)[None])
    scene = snap_exactly(model.apply(layout, 0))
    measure = measured(scene, OPTIONS)
    return Chosen((0, 0), scene, measure, 1, passes(measure, OPTIONS)), layout


@pytest.fixture(scope="module")
def overlapping():
    model = compile_scene(stored_scene("three_overlapping"))
    return model, measured(snap_exactly(model.spec), OPTIONS)


def test_only_necessary_moves_remain(overlapping):
    model, before = overlapping
    assert before.depths_m["first|second"] > OPTIONS.max_depth_m
    chosen, layout = winner(model, [(0, 0), (0, -0.008), (0, 0.012), (0.004, -0.01)])
    assert chosen.passed
    best, nearer = revert_moves(
        model, chosen, layout, Layout.zero(1, len(model.names)), before, OPTIONS
    )
    xy = np.asarray(nearer.xy)[0]
    assert best.passed
    assert best.measure.depths_m.get("first|second", 0.0) <= OPTIONS.max_depth_m
    np.testing.assert_array_equal(xy[3], (0, 0))
    # One of the two overlapping moves may be reverted, or both in part.
    assert np.abs(xy[1:3]).sum() < 0.02
    assert np.abs(xy[1:3]).max() > 0.005
    assert best.scene.object("third").xy == model.spec.object("third").xy


def test_yaw_and_scale_are_reverted_separately_from_position(overlapping):
    model, before = overlapping
    chosen, layout = winner(model, [(0, 0), (0, -0.008), (0, 0.012), (0, 0)])
    layout = eqx.tree_at(
        lambda z: (z.yaw, z.log_scale),
        layout,
        (np.float32([[0, 0.0, 0.04, 0]]), np.float32([[0, -0.01, 0, 0]])),
    )
    scene = snap_exactly(model.apply(layout, 0))
    measure = measured(scene, OPTIONS)
    assert passes(measure, OPTIONS)
    chosen = Chosen((0, 0), scene, measure, 1, True)
    start = Layout.zero(1, len(model.names))
    best, nearer = revert_moves(model, chosen, layout, start, before, OPTIONS)
    assert best.passed and np.abs(np.asarray(nearer.xy)).max() > 0.003
    assert not np.asarray(nearer.yaw).any() and not np.asarray(nearer.log_scale).any()


def test_a_reversion_that_the_photograph_contradicts_is_rejected():
    truth = stored_scene("three_apart")
    moved = compile_scene(
        truth.model_copy(
            update={
                "objects": tuple(
                    o.model_copy(update={"xy": (0.0, -0.12)}) if o.name == "third" else o
                    for o in truth.objects
                )
            }
        )
    )
    before = measured(snap_exactly(moved.spec), OPTIONS)
    chosen, layout = winner(moved, [(0, 0), (0, 0), (0, 0), (0, -0.08)])
    assert chosen.passed
    _, same = revert_moves(moved, chosen, layout, Layout.zero(1, 4), before, OPTIONS)
    np.testing.assert_array_equal(np.asarray(same.xy), np.asarray(layout.xy))


def test_a_heading_that_boxes_constrain_weakly_is_reverted():
    # The photograph shows the third object rotated by 11 degrees, unlike the parse.
    composed, seen = stored_scene("three_apart"), stored_scene("three_turned")
    boxes = {item.name: item.box2d for item in seen.objects}
    objects = [o.model_copy(update={"box2d": boxes[o.name]}) for o in composed.objects]
    model = compile_scene(composed.model_copy(update={"objects": tuple(objects)}))
    start = Layout.zero(1, 4)
    chosen, layout = winner(model, np.zeros((4, 2)))
    layout = eqx.tree_at(lambda z: z.yaw, layout, np.float32([[0, 0, 0, 0.2]]))
    scene = snap_exactly(model.apply(layout, 0))
    chosen = Chosen((0, 0), scene, measured(scene, OPTIONS), 1, True)
    padded = pad_scene(model)
    turned, straight = _placed_agreement(model, padded, [layout, start])
    assert straight.ious["third"] < turned.ious["third"] - NOISE
    _, nearer = revert_moves(model, chosen, layout, start, chosen.measure, OPTIONS)
    assert not np.asarray(nearer.yaw).any()


def test_a_heading_that_boxes_constrain_strongly_is_kept():
    composed, seen = (
        PhotoAgreement({"a": 0.6, "b": 0.9}, 12.0),
        PhotoAgreement({"a": 0.85, "b": 0.9}, 4.0),
    )
    nearer = PhotoAgreement({"a": 0.7, "b": 0.9}, 8.0)
    assert _accepted(nearer, seen, composed, likelihood_gain=5.0) == nearer
    assert _accepted(nearer, seen, composed, likelihood_gain=3.0) is None
    assert _accepted(nearer, seen, composed, likelihood_gain=-np.inf) is None
    # Other objects must agree at least as well as before or as in the initial layout.
    assert _accepted(nearer._replace(ious={"a": 0.7, "b": 0.8}), seen, composed, 5.0) is None
    # Losses within the noise are accepted, but the best IoU remains the reference.
    slightly = PhotoAgreement({"a": 0.84, "b": 0.92}, 4.1)
    assert _accepted(slightly, seen, composed, -np.inf) == PhotoAgreement(
        {"a": 0.85, "b": 0.92}, 4.1
    )


def test_without_checks_nothing_is_reverted(overlapping):
    model, before = overlapping
    chosen, layout = winner(model, [(0, 0), (0, -0.008), (0, 0.012), (0.004, -0.01)])
    start = Layout.zero(1, len(model.names))
    none = OPTIONS.model_copy(update={"returns": 0})
    assert revert_moves(model, chosen, layout, start, before, none) == (chosen, layout)

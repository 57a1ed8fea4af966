"""Objects stand in the alignment: their centers of mass stay over their supports."""

import numpy as np
import pytest

from neoworld_mjx.estimate.align import align
from neoworld_mjx.estimate.rows.contacts import ContactGaps, SceneGeoms
from neoworld_mjx.estimate.rows.standing import MOST_INSET_M, Standing
from neoworld_mjx.spec import world_poses
from tests.estimate import desk

POST = 0.05
"""Width of the post [m]."""


def on_post(x, y=0.0, width=0.06, turn=0.0):
    """A block on a post, with its middle at (x, y) in the frame of the post [m]."""
    scene = desk.on_desk(
        (desk.block("post", POST, POST, 0.1, "red"), (0.0, 0.0), turn, {}),
        (desk.block("top", width, 0.06, 0.06, "blue"), (0.0, 0.0), 0.0, {}),
    )
    placed = {"parent": "post", "xy": (x, y), "z": 0.1, "yaw": 0.0}
    top = scene.object("top").model_copy(update=placed)
    return scene.model_copy(update={"objects": (*scene.objects[:2], top)})


def standing(scene):
    unknowns = desk.unknowns_of(scene)
    return unknowns, Standing.of(unknowns, SceneGeoms.of(scene))


def insets(scene, x=None):
    unknowns, stands = standing(scene)
    x = np.zeros(unknowns.size) if x is None else x
    now = unknowns.place(x[None])[0]
    gaps = list(stands.edges(unknowns, now, 2, 1))
    return unknowns, ContactGaps.of(gaps, unknowns, now, unknowns.neighbors(x))


def test_the_inset_is_the_distance_from_each_edge():
    _, found = insets(on_post(0.01, -0.004))
    inset = 0.1 * POST
    assert np.sort(found.gap) == pytest.approx(
        np.sort([0.025 + 0.01, 0.025 - 0.01, 0.025 - 0.004, 0.025 + 0.004]) - inset, abs=1e-6
    )
    assert inset < MOST_INSET_M


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_its_derivative_is_that_of_the_object_relative_to_its_support(turn):
    scene = on_post(0.012, 0.003, turn=turn)
    unknowns, found = insets(scene)
    move = np.zeros(unknowns.size)
    move[unknowns.columns(1)] = (0.001, -0.002, 0.01, 0.0)
    move[unknowns.columns(2)] = (0.0015, 0.0005, 0.02, 0.0)
    _, moved = insets(scene, move)
    expected = found.jacobian[:, : unknowns.size] @ move
    assert moved.gap - found.gap == pytest.approx(expected, abs=2e-5)
    # A block that moves and turns with its post does not come nearer to an edge.
    carried = np.zeros(unknowns.size)
    carried[unknowns.columns(1)] = (0.002, 0.001, 0.02, 0.0)
    assert found.jacobian[:, : unknowns.size] @ carried == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("x", "width", "stands"),
    [
        (0.0, 0.06, True),
        (0.03, 0.06, True),
        (0.05, 0.06, False),
        (0.14, 0.4, False),
    ],
)
def test_an_object_far_beside_its_support_is_held_by_something_else(x, width, stands):
    _, found = standing(on_post(x, width=width))
    assert ((2, 1) in found.supports) is stands


def test_the_center_is_that_of_all_that_an_object_carries():
    scene = on_post(0.0)
    unknowns, alone = standing(scene)
    heavy = scene.object("top").model_copy(
        update={"name": "load", "parent": "top", "xy": (0.02, 0.0), "z": 0.06}
    )
    loaded = scene.model_copy(update={"objects": (*scene.objects, heavy)})
    _, found = insets(loaded)
    assert found.gap.min() == pytest.approx(0.025 - 0.01 - 0.1 * POST, abs=1e-6)
    assert alone.mass[2] > 0
    assert len(unknowns.free) == 2


def test_an_object_composed_beside_the_edge_of_its_post_is_aligned_over_it():
    truth = desk.boxed(on_post(0.0))
    photo = desk.photograph(truth, 640)
    post = world_poses(truth)["post"].pos
    # The composed block is too far away, along the view, which its contour hardly shows.
    wrong = on_post(0.033)
    boxes = [item.box2d for item in truth.objects]
    items = (
        item.model_copy(update={"box2d": box})
        for item, box in zip(wrong.objects, boxes, strict=True)
    )
    aligned = align(wrong.model_copy(update={"objects": tuple(items)}), photo).scene
    at = world_poses(aligned)
    offset = at["top"].pos[:2] - at["post"].pos[:2]
    assert np.abs(offset).max() < POST / 2
    assert np.linalg.norm(at["post"].pos[:2] - post[:2]) < 0.05


@pytest.mark.parametrize(("width", "stays"), [(0.06, True), (0.3, False)])
def test_a_compact_object_stays_over_its_stated_support_from_a_parsed_place(width, stays):
    """A long object that far from the middle of a post may rest on something else, too."""
    scene = on_post(0.025 + 0.5 * width, width=width)
    unknowns = desk.unknowns_of(scene)
    colliders = SceneGeoms.of(scene)
    assert (2, 1) not in Standing.of(unknowns, colliders).supports
    assert ((2, 1) in Standing.of(unknowns, colliders, parsed=True).supports) == stays

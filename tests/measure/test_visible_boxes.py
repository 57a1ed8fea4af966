import numpy as np
import pytest

from neoworld_mjx.measure import box_iou, shown_sides, visible_box_iou
from neoworld_mjx.spec import Box
from tests.support import scenes


@pytest.fixture(scope="module")
def scene():
    return scenes.stored_scene("photo_1")


def test_the_ground_truth_overlaps_its_photograph_and_a_moved_object_does_not(scene):
    true = visible_box_iou(scene)
    assert set(true) == {o.name for o in scene.objects if not o.environment}
    assert min(true.values()) > 0.9 and np.mean([*true.values()]) > 0.97
    first = scene.objects[1]
    shifted = scenes.changed(scene, first.name, xy=(first.xy[0], first.xy[1] + 1.0))
    measured = box_iou({first.name: 0.75}, scene, shifted)
    assert measured["parsed"] == 0.75
    assert measured["composed"] == pytest.approx(np.mean([*true.values()]))
    assert measured["refined"] < measured["composed"]
    assert measured["worst"] == {"name": first.name, "value": 0.0}
    assert measured["objects"][first.name]["composed"] == true[first.name]


def test_a_side_is_an_objects_own_without_an_occluder(scene):
    """Two blocks one behind the other, and one that the picture's border cuts."""
    block = scenes.single("block", (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0)))
    at = lambda x, y: (block, (x - 0.5, y), 0.0)
    near, far, cut = (
        (spec.model_copy(update={"name": name}), xy, yaw, {})
        for name, (spec, xy, yaw) in zip(
            ("near", "far", "cut"), (at(0.4, 0.06), at(0.6, 0.0), at(0.5, 0.28)), strict=True
        )
    )
    shown = shown_sides(scenes.on_table(near, far, cut))
    assert set(shown) == {"near", "far", "cut"}
    assert shown["near"].object_ends.all() and shown["near"].inside.all()
    # Left, top, right, bottom: the near one stands before the lower side of the far one.
    assert shown["far"].object_ends.tolist() == [True, True, True, False]
    assert shown["far"].inside.all()
    assert not shown["cut"].inside[0] and not shown["cut"].object_ends[0]
    assert shown["cut"].object_ends[2]

import numpy as np
import pytest

from neoworld_mjx.measure import box_iou, visible_box_iou
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

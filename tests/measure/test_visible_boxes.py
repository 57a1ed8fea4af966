import numpy as np
import pytest

from neoworld_mjx.measure import box_iou, visible_box_iou
from neoworld_mjx.measure.boxes import visible_boxes
from neoworld_mjx.spec import Box, Camera, SceneObject, SceneSpec, world_poses
from tests.support import scenes

GLASS = scenes.WOOD.model_copy(update={"name": "glass", "rgba": (0.9, 0.9, 0.9, 0.2)})


def boxed(name, size, material=scenes.WOOD):
    return scenes.single(name, (Box(size=size), (0, 0, 0)), material=material)


@pytest.fixture(scope="module")
def scene():
    return scenes.stored_scene("photo_1")


def test_the_ground_truth_overlaps_its_photograph_and_a_moved_object_does_not(scene):
    true = visible_box_iou(scene)
    assert set(true) == {o.name for o in scene.objects if not o.environment}
    # Its boxes are those of the rendered photograph, occluded objects included.
    assert min(true.values()) > 0.995
    first = scene.objects[1]
    shifted = scenes.changed(scene, first.name, xy=(first.xy[0], first.xy[1] + 1.0))
    measured = box_iou({first.name: 0.75}, scene, shifted)
    assert measured["parsed"] == 0.75
    assert measured["composed"] == pytest.approx(np.mean([*true.values()]))
    assert measured["refined"] < measured["composed"]
    assert measured["worst"] == {"name": first.name, "value": 0.0}
    assert measured["objects"][first.name]["composed"] == true[first.name]


def test_a_box_is_that_of_the_visible_part():
    camera = Camera(width=640, height_px=480, fovy=0.6, height=0.15, pitch=0.0)
    wide, near = (boxed(n, s) for n, s in (("wide", (0.1, 0.4, 0.1)), ("near", (0.1, 0.1, 0.3))))
    items = (
        SceneObject(name="table", spec=scenes.table(), environment=True, xy=(1.2, 0.0), z=-0.04),
        SceneObject(name="wide", spec=wide, parent="table", xy=(0.0, 0.0), z=0.04),
        SceneObject(name="near", spec=near, parent="table", xy=(-0.2, 0.2), z=0.04),
    )
    scene = SceneSpec(objects=items, camera=camera)
    boxes = visible_boxes(scene, camera, ("wide", "near"))
    alone = visible_boxes(scenes.without(scene, "near"), camera, ("wide",))["wide"]
    # The near box hides the left end of the wide one; the other three sides are exact.
    assert boxes["wide"][0] == pytest.approx(boxes["near"][2], abs=1.0)
    assert boxes["wide"][0] > alone[0] + 20
    assert boxes["wide"][1:] == pytest.approx(alone[1:], abs=1e-9)
    corners = world_poses(scene)["near"].apply(
        np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (0.0, 0.3)])
    )
    pixels, _ = camera.project(corners)
    assert boxes["near"] == pytest.approx([*pixels.min(axis=0), *pixels.max(axis=0)], abs=1e-6)


def test_a_see_through_object_hides_nothing_and_a_hidden_one_has_no_area():
    camera = Camera(width=640, height_px=480, fovy=0.6, height=0.3, pitch=0.1)

    def boxes(material):
        front = boxed("front", (0.02, 0.6, 0.4), material)
        behind = boxed("behind", (0.1, 0.1, 0.1))
        items = (
            SceneObject(
                name="table", spec=scenes.table(), environment=True, xy=(1.2, 0.0), z=-0.04
            ),
            SceneObject(name="behind", spec=behind, parent="table", xy=(0.2, 0.0), z=0.04),
            SceneObject(name="front", spec=front, parent="table", xy=(-0.2, 0.0), z=0.04),
        )
        return visible_boxes(SceneSpec(objects=items, camera=camera), camera, ("behind", "front"))

    glass = GLASS
    wood, seen = boxes(scenes.WOOD), boxes(glass)
    assert np.all(wood["behind"] == 0.0) and np.ptp(seen["behind"][[0, 2]]) > 20
    assert np.array_equal(wood["front"], seen["front"])

"""A written scene has world poses for other programs, and reads back equal."""

import json

import pytest

from neoworld_mjx.errors import SpecError
from neoworld_mjx.spec import Box, SceneObject, SceneSpec
from tests.support import mechanisms, scenes


def test_a_written_scene_has_world_poses_and_reads_back_equal():
    shelf = SceneObject(name="shelf", spec=mechanisms.cabinet(), xy=(0.5, 0.0), z=1.0)
    cup = mechanisms.single("cup", Box(size=(0.1, 0.1, 0.1)))
    held = SceneObject(name="cup", spec=cup, parent="shelf", xy=(0.0, 0.1), z=0.2)
    scene = SceneSpec(objects=(shelf, held))
    written = json.loads(scene.to_json())
    assert written["world_poses"]["cup"]["pos"] == pytest.approx([0.5, 0.1, 1.2])
    assert SceneSpec.model_validate(written) == scene
    assert SceneSpec.model_validate(written | {"semantics": {}}) == scene


def test_an_object_that_a_scene_does_not_have_is_named_with_the_choices():
    scene = scenes.furnished()
    assert scene.object(scene.objects[1].name) is scene.objects[1]
    for look_up in (scene.object, scene.index):
        with pytest.raises(SpecError, match=r"object: got 'tabel', .*table"):
            look_up("tabel")

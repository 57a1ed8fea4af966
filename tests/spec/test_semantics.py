"""Categories and purposes in words, and where a scene says them."""

import json

import pytest

from neoworld_mjx.spec import Box, SceneObject, SceneSpec
from neoworld_mjx.spec.semantics import category, purpose
from tests.support import mechanisms


@pytest.mark.parametrize(
    ("name", "label", "want"),
    [
        ("a", "oak chest with a drawer", "chest"),
        ("a", "Microwave oven", "oven"),
        ("a", "cup of coffee", "cup"),
        ("mug_2", "", "mug"),
        ("x", "12", "x"),
    ],
)
def test_the_category_is_the_head_noun_of_the_label(name, label, want):
    spec = mechanisms.single(name, Box(size=(0.1, 0.1, 0.1)))
    assert category(spec.model_copy(update={"label": label})) == want


def test_the_purpose_of_a_joint_follows_its_child():
    spec = mechanisms.cabinet()
    found = {joint.name: purpose(spec, joint) for joint in spec.joints}
    assert found["slide"] == "drawer" and found["spin"] == "wheel" and found["hinge"] == "hinge"
    assert found["follow"] == "flap"
    assert {purpose(spec, joint) for joint in spec.joints if joint.type == "fixed"} == {"fixed"}


def test_a_written_scene_has_semantics_and_reads_back_equal():
    spec = mechanisms.cabinet()
    scene = SceneSpec(objects=(SceneObject(name="one", spec=spec),))
    said = json.loads(scene.to_json())["semantics"]["one"]
    assert said["label"] == spec.label and said["category"] == "cabinet"
    assert said["joints"]["slide"] == "drawer" and "drawer" in said["parts"]
    assert SceneSpec.model_validate_json(scene.to_json()) == scene

"""Placement of objects, joints and free fall of `neoworld view`, without a browser."""

import json
import math

import numpy as np
import pytest

from neoworld_mjx.compose.layout_patch import LayoutPatch
from neoworld_mjx.compose.on_supports import snap
from neoworld_mjx.config import Config
from neoworld_mjx.program.building import run
from neoworld_mjx.run_folder import RunFolder
from neoworld_mjx.spec import world_poses
from neoworld_mjx.spec.pose import from_yaw, pose, yaw_of
from neoworld_mjx.spec.scene import PoseUncertainty
from neoworld_mjx.templates import template
from neoworld_mjx.view.scene_nodes import FreeFall, part_poses
from neoworld_mjx.view.scene_viewer import PlacedScene, object_facts, settable_joints
from neoworld_mjx.view.target import fixed_object_scene, open_target
from tests.support import scenes


@pytest.fixture(scope="module")
def cabinet():
    built = run(template("drawer_cabinet").program())
    assert built.spec is not None
    return fixed_object_scene(built.spec)


def test_dragging_a_handle_moves_an_object_and_its_children():
    scene = snap(scenes.blocks())
    carried = next(o for o in scene.objects if o.parent and not scene.object(o.parent).environment)
    name = carried.parent
    placed = PlacedScene(scene, LayoutPatch())
    at = placed.handle_pose(name)
    before = world_poses(scene)
    goal = at.pos + [0.03, -0.02, 0.5]
    placed.place(name, pose(goal, from_yaw(yaw_of(at.quat) + 0.4)))
    after = world_poses(placed.scene)
    assert np.allclose(after[name].pos, [*goal[:2], before[name].pos[2]])
    assert math.isclose(yaw_of(after[name].quat), yaw_of(before[name].quat) + 0.4, abs_tol=1e-9)
    assert not np.allclose(after[carried.name].pos, before[carried.name].pos)
    assert set(placed.patch.objects) == {name}


def test_a_joint_moves_its_part_and_the_simulation_starts_there(cabinet):
    placed = PlacedScene(cabinet, LayoutPatch())
    obj = cabinet.objects[0]
    joint, key = settable_joints(obj)[0]
    placed.set_joint(obj.name, key, 0.5 * joint.upper)
    before, after = part_poses(cabinet), part_poses(placed.scene)
    moved = {
        part for (_, part), at in after.items() if not np.allclose(at.pos, before[_, part].pos)
    }
    assert joint.child in moved and obj.spec.root not in moved
    assert placed.patch.objects[obj.name].joint_state == {key: 0.5 * joint.upper}
    for part, at in FreeFall(placed.scene, lambda _: None).poses().items():
        assert np.allclose(at.pos, after[part].pos, atol=1e-9), part


def test_viewer_names_the_evidence_of_an_object(tmp_path):
    scene = scenes.coffee()
    known = PoseUncertainty(along=0.004, across=0.001, yaw=0.03, log_scale=0.02)
    depth = {"pixels": 90, "before_m": 0.02, "after_m": 0.001, "rise_m": 0.0}
    change = {"evidence": "none", "reason": "it is hidden", "depth": depth}
    with RunFolder(tmp_path / "out", Config()) as run, run.step("compose", {}) as stage:
        (stage / "compose").mkdir()
        composed = scenes.changed(scene, "cup", uncertainty=known)
        (stage / "compose" / "scene.json").write_text(composed.to_json())
        align = {"objects": {"cup": change}}
        (stage / "compose" / "align.json").write_text(json.dumps(align))
    target = open_target(tmp_path / "out", Config())
    cup = target.after.object("cup")
    facts = object_facts(target, cup)
    assert "contour: not used: it is hidden" in facts
    assert f"puts it 0 mm above {cup.parent}" in " ".join(facts)
    assert "known to: along the view ±4 mm, across ±1 mm, heading ±2°, size ±2 %" in facts
    (tmp_path / "out" / "compose" / "align.json").write_text('{"objects": {"cup": 3}}')
    assert "unexpected structure" in " ".join(object_facts(target, target.after.object("cup")))

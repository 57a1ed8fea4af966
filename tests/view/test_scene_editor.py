import math

import numpy as np
import pytest
from neoworld_mjx.view.pages.free_fall import FreeFall
from neoworld_mjx.view.pages.scene_editor import SceneEditor, settable_joints
from neoworld_mjx.view.pages.scene_nodes import part_poses
from neoworld_mjx.view.pages.view_target import open_target, single_object_scene

from neoworld_mjx.compose.layout_patch import LayoutPatch
from neoworld_mjx.compose.on_supports import snap
from neoworld_mjx.config import Config
from neoworld_mjx.errors import RunError, SpecError
from neoworld_mjx.program.sandbox import run
from neoworld_mjx.render.part_meshes import creased, piece_meshes, visible_meshes
from neoworld_mjx.spec import world_poses
from neoworld_mjx.spec.pose import from_yaw, yaw_of
from neoworld_mjx.templates import template
from tests.support import scenes


@pytest.fixture(scope="module")
def cabinet():
    built = run(template("drawer_cabinet").program())
    assert built.spec is not None
    return single_object_scene(built.spec)


def test_dragging_a_handle_moves_an_object_and_its_children():
    scene = snap(scenes.blocks())
    carried = next(o for o in scene.objects if o.parent and not scene.object(o.parent).environment)
    name = carried.parent
    editor = SceneEditor(scene, LayoutPatch())
    at = editor.handle_pose(name)
    before = world_poses(scene)
    goal = at.pos + [0.03, -0.02, 0.5]
    editor.place(name, goal, from_yaw(yaw_of(at.quat) + 0.4))
    after = world_poses(editor.scene)
    assert np.allclose(after[name].pos, [*goal[:2], before[name].pos[2]])
    assert math.isclose(yaw_of(after[name].quat), yaw_of(before[name].quat) + 0.4, abs_tol=1e-9)
    assert not np.allclose(after[carried.name].pos, before[carried.name].pos)
    assert set(editor.patch.objects) == {name}


def test_a_joint_moves_its_part_and_no_other(cabinet):
    editor = SceneEditor(cabinet, LayoutPatch())
    obj = cabinet.objects[0]
    joint, key = settable_joints(obj)[0]
    editor.set_joint(obj.name, key, 0.5 * joint.upper)
    before, after = part_poses(cabinet), part_poses(editor.scene)
    moved = {
        part for (_, part), at in after.items() if not np.allclose(at.pos, before[_, part].pos)
    }
    assert joint.child in moved and obj.spec.root not in moved
    assert editor.patch.objects[obj.name].joint_state == {key: 0.5 * joint.upper}


def test_the_simulation_starts_at_the_shown_poses(cabinet):
    obj = cabinet.objects[0]
    joint, key = settable_joints(obj)[0]
    editor = SceneEditor(cabinet, LayoutPatch())
    editor.set_joint(obj.name, key, 0.5 * joint.upper)
    fall = FreeFall(editor.scene, lambda _: None)
    shown = part_poses(editor.scene)
    for part, at in fall.poses().items():
        assert np.allclose(at.pos, shown[part].pos, atol=1e-9), part


def test_a_push_moves_a_movable_object_and_restart_puts_it_back():
    scene = snap(scenes.blocks())
    name = next(obj.name for obj in scene.objects if not obj.static)
    fixed = next(obj.name for obj in scene.objects if obj.static)
    fall = FreeFall(scene, lambda _: None)
    before = fall.poses()
    assert not fall.push(fixed, np.array([1.0, 0, 0]))
    assert fall.push(name, np.array([1.0, 0, 0]))
    fall.step(0.04)
    root = scene.object(name).spec.root
    assert fall.poses()[name, root].pos[0] - before[name, root].pos[0] > 0.02
    assert fall.contacts().points.shape[1:] == (3,)
    fall.reset()
    assert np.allclose(fall.poses()[name, root].pos, before[name, root].pos)


def test_meshes_cover_the_object_and_keep_sharp_edges(cabinet):
    spec = cabinet.objects[0].spec
    for part in spec.parts:
        seen, pieces = visible_meshes(spec, part), piece_meshes(part)
        assert seen and pieces
        for one, other in ((np.min, np.min), (np.max, np.max)):
            a = one(np.concatenate([m.vertices for m in seen]), axis=0)
            b = other(np.concatenate([m.vertices for m in pieces]), axis=0)
            assert np.allclose(a, b, atol=0.03)
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]])
    faces = np.concatenate([faces, [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4]]])
    faces = np.concatenate([faces, [[1, 5, 7], [1, 7, 3]]])
    assert len(creased(cube, faces)[0]) == 24


@pytest.mark.parametrize("kind", ["missing", "empty folder", "no program", "busy port"])
def test_invalid_targets_are_one_clear_error(kind, tmp_path):
    config = Config()
    if kind == "busy port":
        local = pytest.importorskip("neoworld_mjx.view.pages.local_server")
        import socket

        pytest.importorskip("viser")
        with socket.create_server(("127.0.0.1", 0)) as taken:
            with pytest.raises(RunError, match="--port"):
                local.open_server("x", port=taken.getsockname()[1])
        return
    path = {"missing": "none/scene.json", "empty folder": "", "no program": "a.py"}[kind]
    if path == "a.py":
        (tmp_path / path).write_text("x = 1\n")
    with pytest.raises(SpecError, match=r"scene\.json|builds no object|no such|No such"):
        open_target(tmp_path / path, config)

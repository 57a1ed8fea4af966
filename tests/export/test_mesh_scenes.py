"""Scenes of posed meshes: glTF, and poses.json next to meshes and models."""

import json

import numpy as np
import pytest

from neoworld_mjx.errors import EvidenceError, SpecError
from neoworld_mjx.evidence.camera_files import read_camera
from neoworld_mjx.evidence.file_camera import known_camera
from neoworld_mjx.export.importing import ImportedScene, import_file
from neoworld_mjx.export.read_mesh_scene import read_mesh_scene
from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import SceneSpec, world_poses
from neoworld_mjx.spec.pose import from_yaw, pose
from neoworld_mjx.spec.scene import transformed_scene
from tests.support.bop_sample import desk
from tests.support.mesh_scenes import write_glb, write_poses


def world_vertices(scene: SceneSpec, name: str) -> np.ndarray:
    item = scene.object(name)
    vertices = world_poses(scene)[name].apply(visible_surface(item.spec, item.joint_state)[0])
    return vertices[np.lexsort(np.round(vertices, 6).T)]


def assert_same_surfaces(read: SceneSpec, scene: SceneSpec) -> None:
    assert {item.name for item in read.objects} == {item.name for item in scene.objects}
    for item in scene.objects:
        own, other = world_vertices(read, item.name), world_vertices(scene, item.name)
        gap = np.linalg.norm(own[:, None] - other[None], axis=-1)
        assert gap.min(axis=1).max() < 1e-6 and gap.min(axis=0).max() < 1e-6


@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_gltf_scene_keeps_names_places_and_headings(tmp_path, scale):
    read = import_file(write_glb(tmp_path / "desk.glb", desk(), scale))
    assert isinstance(read, ImportedScene)
    assert_same_surfaces(read.spec, desk())
    for name, at in world_poses(desk()).items():
        assert np.allclose(world_poses(read.spec)[name].pos, at.pos, atol=1e-6)
        assert abs(np.dot(world_poses(read.spec)[name].quat, at.quat)) == pytest.approx(1)
    assert sum("has no colliders: derived from its visuals" in note for note in read.notes) == 4
    assert not any(item.static for item in read.spec.objects)


def test_poses_beside_meshes(tmp_path):
    read = import_file(write_poses(tmp_path, desk()))
    assert isinstance(read, ImportedScene)
    assert_same_surfaces(read.spec, desk())
    assert [item.name for item in read.spec.objects if item.static] == ["table"]
    assert read.spec.gravity == (0, 0, -9.81)


def test_poses_in_the_frame_of_a_camera(tmp_path):
    scene = desk()
    axes, eye = scene.camera.axes(), scene.camera.position()
    into = np.eye(4)
    into[:3, :3], into[:3, 3] = axes.T, -axes.T @ eye
    up = (axes.T @ [0, 0, 1]).tolist()
    file = write_poses(tmp_path, scene, into=into, frame="camera", up=up)
    read = import_file(file)
    # Leveled: as in the world, whose origin is below the camera, but for the camera's height.
    for name in ("block", "carton"):
        pos = world_poses(scene)[name].pos - [0, 0, scene.camera.height]
        assert np.allclose(world_poses(read.spec)[name].pos, pos, atol=1e-9)
    assert read.spec.gravity == (0, 0, -9.81) and read.in_camera
    assert np.allclose(np.array(read.camera.pose)[:3, :3], axes)
    known, _ = known_camera(read.camera, (160, 120), "poses.json")
    assert known.pitch == pytest.approx(0.6) and known.roll == pytest.approx(0)


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_camera_of_a_gltf_scene_is_where_the_scene_has_it(tmp_path, scale):
    """A camera below a node with a scale is rigid all the same."""
    given = desk()
    camera = given.camera.model_copy(update={"roll": 0.05})
    by = pose((0.3, -0.2, 0.1), from_yaw(0.7))
    turned = transformed_scene(given, by)
    file = write_glb(tmp_path / "desk.glb", turned, camera=(camera, by), camera_scale=scale)
    read = import_file(file)
    known, _ = known_camera(read.camera, (camera.width, camera.height_px), "desk.glb")
    assert known.camera(camera).model_dump() == pytest.approx(camera.model_dump(), abs=1e-6)
    assert known.base == pytest.approx((0.3, -0.2, camera.height + 0.1), abs=1e-6)
    assert known.heading == pytest.approx(0.7)
    assert_same_surfaces(read.spec, turned)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"fx": 3.0}, "must be given together"),
        ({"fovy": 0.5, "fx": 3, "fy": 3, "cx": 1, "cy": 1}, "not both"),
        ({"pose": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "not a rigid"),
        ({"fov": 0.5}, "fov"),
    ],
)
def test_broken_cameras_give_one_error(tmp_path, fields, message):
    (tmp_path / "camera.json").write_text(json.dumps(fields))
    with pytest.raises(EvidenceError, match=message):
        read_camera(tmp_path / "camera.json")


def test_a_list_of_poses_says_what_is_fixed_and_where_models_are(tmp_path):
    box = "<geom type='box' size='.1 .1 .1'/>"
    (tmp_path / "a.xml").write_text(
        "<mujoco><option gravity='0 0 -1.6'/><worldbody><geom name='ground' type='plane' "
        f"size='1 1 1'/><body name='chest'>{box}<body name='lid' pos='0 0 .2'><joint name='j' "
        f"range='0 90'/>{box}</body></body></worldbody></mujoco>"
    )
    pose = np.eye(4)
    pose[2, 3] = 0.5
    for fixed in (False, True):
        objects = {"chest": {"file": "a.xml", "pose": pose.tolist(), "fixed": fixed}}
        (tmp_path / "poses.json").write_text(json.dumps({"objects": objects}))
        read = import_file(tmp_path / "poses.json")
        (item,) = read.spec.objects
        assert item.fixed_base == fixed and item.z == pytest.approx(0.4)
    reported = " / ".join(read.notes)
    assert "ground of the world is not imported" in reported
    assert "gravity 0 0 -1.6 m/s^2 is not kept" in reported


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"file": "../block.obj"}, "outside its folder"),
        ({"file": "none.obj"}, "does not exist"),
        ({"file": "notes.txt"}, "URDF or MJCF"),
        ({"pose": np.diag([1.0, 1, 0, 1]).tolist()}, "block.*singular"),
        ({"pose": np.ones((4, 4)).tolist()}, "not an affine"),
        ({"pose": [[1, 2], [3, 4]]}, "not a list of posed files"),
        ({"scale": 2}, "not a list of posed files"),
    ],
)
def test_broken_poses_give_one_error(tmp_path, change, message):
    home = tmp_path / "home"
    file = write_poses(home, desk(), names=["block"])
    (tmp_path / "block.obj").write_bytes((home / "block.obj").read_bytes())
    (home / "notes.txt").write_text("x")
    content = json.loads(file.read_text())
    content["objects"]["block"] |= change
    file.write_text(json.dumps(content))
    with pytest.raises(SpecError, match=message):
        read_mesh_scene(file)

"""glTF scenes: nodes that are objects, cameras, and the export read back."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.transformations import rotation_matrix, translation_matrix

from neoworld_mjx.export.importing import import_file
from neoworld_mjx.export.write_glb import glb_bytes
from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import SceneSpec, world_poses
from tests.support import scenes


def nested(nodes: dict[str, tuple[str | None, bool]]) -> trimesh.Scene:
    """Return a scene of nodes (parent, has a mesh), each 1 m beside its parent."""
    made = trimesh.Scene()
    for name, (parent, has_mesh) in nodes.items():
        at = {"transform": translation_matrix((1.0, 0, 0)), "node_name": name}
        if has_mesh:
            box = trimesh.creation.box((0.1, 0.2, 0.3))
            made.add_geometry(box, parent_node_name=parent, geom_name=f"{name}-mesh", **at)
        else:
            made.graph.update(frame_to=name, frame_from=parent, matrix=at["transform"])
    return made


@pytest.mark.parametrize(
    ("nodes", "objects"),
    [
        ({"cup": (None, True), "plate": (None, True)}, {"cup": 1, "plate": 1}),
        # A root above everything, as older versions of trimesh write it, or several.
        (
            {"world": (None, False), "cup": ("world", True), "plate": ("world", True)},
            {"cup": 1, "plate": 1},
        ),
        (
            {"a": (None, False), "b": ("a", False), "cup": ("b", True), "plate": ("b", True)},
            {"cup": 1, "plate": 1},
        ),
        # Objects of several meshes: below an empty, and below a mesh.
        (
            {"cup": (None, False), "a": ("cup", True), "b": ("cup", True), "plate": (None, True)},
            {"cup": 2, "plate": 1},
        ),
        (
            {"w": (None, False), "cup": ("w", True), "ear": ("cup", True), "rim": ("ear", True),
             "plate": ("w", True)},
            {"cup": 3, "plate": 1},
        ),
        # Nodes without meshes, such as lights, are no objects.
        ({"sun": (None, False), "w": (None, False), "cup": ("w", True), "ear": ("cup", True)},
         {"cup": 2}),
        ({"cup": (None, True), "ear": ("cup", True)}, {"cup": 2}),
    ],
)  # fmt: skip
def test_top_level_nodes_are_objects_with_all_meshes_below(tmp_path, nodes, objects):
    made = nested(nodes)
    made.export(tmp_path / "scene.glb")
    read = import_file(tmp_path / "scene.glb").spec
    assert {o.name: len(o.spec.parts[0].geoms) for o in read.objects} == objects
    for item in read.objects:  # x stays x with Z up.
        assert world_poses(read)[item.name].pos[1] == pytest.approx(0, abs=1e-9)
        assert all(len(part.geoms) for part in item.spec.parts)


def test_meshes_of_a_group_are_where_their_nodes_put_them(tmp_path):
    """Groups that are turned, with meshes that are scaled and mirrored."""
    made = trimesh.Scene()
    made.graph.update(frame_to="cup", matrix=rotation_matrix(0.7, (0, 1, 0), (0.3, 0, 0)))
    mirrored = np.diag([-2.0, 1, 1, 1]) @ translation_matrix((0.1, 0.2, 0.3))
    wedge = trimesh.Trimesh([[0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1.0]],
                            [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])  # fmt: skip
    made.add_geometry(wedge, node_name="a", parent_node_name="cup", transform=mirrored)
    made.add_geometry(trimesh.creation.box((1, 1, 1)), node_name="b", parent_node_name="cup")
    made.add_geometry(trimesh.creation.box((1, 1, 1)), node_name="plate")
    made.export(tmp_path / "scene.glb")
    read = import_file(tmp_path / "scene.glb").spec
    geoms = read.object("cup").spec.parts[0].geoms
    at = world_poses(read)["cup"]
    own = [at.apply(geom.pose().apply(geom.shape.surface()[0])) for geom in geoms]
    x, y, z = np.vstack(own).T
    turned = np.column_stack([x, z, -y])
    for name in ("a", "b"):
        at, key = made.graph[name]
        for corner in trimesh.transform_points(made.geometry[key].vertices, at):
            assert np.linalg.norm(turned - corner, axis=1).min() < 1e-6
    for geom in geoms:
        assert trimesh.Trimesh(*geom.shape.surface()).volume > 0


@pytest.fixture
def exported(tmp_path) -> tuple[SceneSpec, dict, Path]:
    """A scene with an open cabinet, the JSON of its file, and the file."""
    scene, file = scenes.furnished(), tmp_path / "scene.glb"
    file.write_bytes(glb_bytes(scene))
    return scene, document_of(file), file


def document_of(file: Path) -> dict:
    data = file.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def test_export_has_a_root_for_each_object_and_the_camera(exported):
    scene, document, _ = exported
    nodes = document["nodes"]
    roots = {nodes[k]["name"]: nodes[k] for k in document["scenes"][0]["nodes"]}
    assert set(roots) == {*(item.name for item in scene.objects), "furnished-camera"}
    cabinet = {nodes[k]["name"] for k in roots["cabinet"]["children"]}
    assert cabinet == {f"cabinet-{part.name}" for part in scene.object("cabinet").spec.parts}
    camera = scene.camera
    lens = document["cameras"][roots["furnished-camera"]["camera"]]["perspective"]
    assert lens["yfov"] == pytest.approx(camera.fovy)
    assert lens["aspectRatio"] == pytest.approx(camera.width / camera.height_px)
    # What the camera sees ahead is along the node's -z; its image's right is +x, its top +y.
    matrix = np.reshape(roots["furnished-camera"]["matrix"], (4, 4)).T
    right, down, ahead = ([x, z, -y] for x, y, z in camera.axes().T)
    assert np.allclose(
        matrix[:3, :3], np.column_stack([right, np.negative(down), np.negative(ahead)])
    )
    assert np.allclose(matrix[:3, 3], [0, camera.height, 0])


def test_export_read_back_has_the_same_objects_and_camera(exported):
    scene, _, file = exported
    read = import_file(file)
    assert {item.name for item in read.spec.objects} == {item.name for item in scene.objects}
    assert read.camera.fovy == pytest.approx(scene.camera.fovy)
    assert np.allclose(np.array(read.camera.pose)[:3, :3], scene.camera.axes())
    for item in scene.objects:
        for own, other in zip(box_of(scene, item.name), box_of(read.spec, item.name), strict=True):
            assert np.allclose(own, other, atol=1e-6), item.name


def box_of(scene: SceneSpec, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest corner of an object's visible surface in the world."""
    item = scene.object(name)
    points = world_poses(scene)[name].apply(visible_surface(item.spec, item.joint_state)[0])
    return points.min(axis=0), points.max(axis=0)

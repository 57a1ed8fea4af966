"""Scenes as posed meshes, as other methods write them: glTF, and poses next to OBJ files."""

import json
from pathlib import Path

import numpy as np
import trimesh
from trimesh.scene import Camera

from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import SceneSpec, world_poses
from neoworld_mjx.spec.pose import matrix

TO_GLTF = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From Z up to glTF's axes, Y up."""


def object_matrices(scene: SceneSpec) -> dict[str, np.ndarray]:
    """Return the pose [4, 4] of every object in the world."""
    result = {}
    for name, pose in world_poses(scene).items():
        result[name] = np.eye(4)
        result[name][:3, :3], result[name][:3, 3] = matrix(pose.quat), pose.pos
    return result


def object_mesh(scene: SceneSpec, name: str) -> trimesh.Trimesh:
    """Return the visible surface of an object in its own frame."""
    item = scene.object(name)
    return trimesh.Trimesh(*visible_surface(item.spec, item.joint_state), process=False)


def write_glb(
    file: Path, scene: SceneSpec, scale: float = 1.0, *, camera=None, camera_scale=1.0
) -> Path:
    """Write a scene as glTF; meshes are stored smaller by a scale that their nodes apply.

    Args:
        file: to write.
        scene: the scene.
        scale: of the stored meshes.
        camera: a camera, and what moved its world to that of the scene.
        camera_scale: scale of the camera's node.
    """
    made = trimesh.Scene()
    if camera is not None:
        seen, moved = camera
        at = moved.then(seen.pose())
        matrix4 = np.eye(4)
        matrix4[:3, :3], matrix4[:3, 3] = matrix(at.quat), at.pos
        fov = np.degrees([seen.fovy * seen.width / seen.height_px, seen.fovy])
        made.camera = Camera(name="camera", resolution=(seen.width, seen.height_px), fov=fov)
        matrix4[:3, :3] *= camera_scale
        made.camera_transform = TO_GLTF @ matrix4
    for name, pose in object_matrices(scene).items():
        mesh = object_mesh(scene, name)
        mesh.apply_transform(TO_GLTF)
        mesh.apply_scale(1 / scale)
        node = TO_GLTF @ pose @ TO_GLTF.T
        node[:3, :3] *= scale
        made.add_geometry(mesh, node_name=name, geom_name=name, transform=node)
    file.parent.mkdir(parents=True, exist_ok=True)
    made.export(file, file_type="glb")
    return file


def write_poses(folder: Path, scene: SceneSpec, *, into=None, names=(), **fields) -> Path:
    """Write OBJ files and poses.json.

    Args:
        folder: to write to.
        scene: the scene.
        into: transform [4, 4] from the world to the frame of the poses.
        names: of the objects; all by default.
        fields: of poses.json, such as `frame`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    into = np.eye(4) if into is None else into
    objects = {}
    for name, pose in object_matrices(scene).items():
        if names and name not in names:
            continue
        object_mesh(scene, name).export(folder / f"{name}.obj")
        objects[name] = {
            "file": f"{name}.obj",
            "pose": (into @ pose).tolist(),
            "fixed": scene.object(name).static,
        }
    (folder / "poses.json").write_text(json.dumps({"objects": objects, **fields}))
    return folder / "poses.json"

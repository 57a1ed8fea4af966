"""Reads scenes of meshes from glTF 2.0 files, or from a file that lists poses of meshes and models.

A glTF file is in meters with Y up; its objects are groups of nodes. A list of poses is

    poses.json               {"frame": "world", "objects": {"mug": {"file": "mug.obj",
                              "pose": [[4x4]], "fixed": false}}, "camera": {...}}

A pose is the transform from the frame of an object's file to the world frame (Z up). With "frame":
"camera", it is the transform to the frame of the photograph's camera (OpenCV: x right, y down, z
ahead). In this case, "up" states the vertical in the camera's frame, the scene is rotated so that
"up" becomes z, and "camera" (`FileCamera`) states only intrinsics. Otherwise, "camera" states the
pose and the intrinsics of the photograph's camera.
"""

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..errors import EvidenceError, PhotoError, SpecError
from ..evidence.file_camera import (
    TO_OPENCV,
    FileCamera,
    Rows,
    camera_angles,
    intrinsics,
    level_transform,
    rows_of,
)
from ..evidence.lens import Lens
from ..io import read_model
from ..spec import Camera, Spec
from ..spec.base import Vec3
from ..spec.pose import Pose, from_yaw, pose, rotate
from .load_mesh import (
    SUFFIXES,
    folder_buffers,
    gltf_document,
    inside,
    load_mesh,
    merged_vertices,
    mesh_bytes,
)
from .mechanism import Assembly, Link, LinkShape, Mechanism, Triangles
from .write_glb import OBJECT_EXTRAS, Y_UP

POSES = "poses.json"
MAX_NODES = 500


class Viewpoint(NamedTuple):
    """Camera of a photograph, and the transform that moves the scene in front of the camera."""

    camera: Camera
    scene_transform: Pose
    """Horizontal translation and rotation about the vertical that are applied to the scene, so that
    the camera is above the origin and heads along +x."""
    lens: Lens | None = None
    """Lens of the photograph, if the camera's image is the undistorted photograph."""


def viewpoint(camera: FileCamera, width: int, height: int, source: str = "camera") -> Viewpoint:
    """Return the camera of a photograph, and the transform of the scene to the camera.

    Args:
        camera: the camera, with pose and intrinsics.
        width: width of the photograph [px].
        height: height of the photograph [px].
        source: where the camera comes from, for messages.

    Raises:
        EvidenceError: the intrinsics do not fit the photograph.
        PhotoError: the camera has no pose or no intrinsics.
    """
    matrix = camera.matrix()
    if matrix is None or (camera.fovy is None and camera.fx is None):
        missing = "pose" if matrix is None else "field of view (fovy, or fx, fy, cx and cy)"
        raise PhotoError(f"the camera of the photograph has no {missing}: {CAMERA_HELP}")
    known, lens = intrinsics(camera, (width, height), source)
    heading, pitch, roll = camera_angles(matrix[:3, :3])
    rotation = from_yaw(-heading)
    eye = rotate(rotation, matrix[:3, 3])
    size = known.size
    blank = Camera(
        width=size[0], height_px=size[1], fovy=1, height=float(eye[2]), pitch=pitch, roll=roll
    )
    transform = pose((-float(eye[0]), -float(eye[1]), 0.0), rotation)
    return Viewpoint(known.camera(blank), transform, lens)


CAMERA_HELP = (
    'give it by --camera FILE.json, as {"fx": 600, "fy": 600, "cx": 320, "cy": 240, '
    '"pose": [[4x4]]}, '
    "where pose transforms the camera's frame (OpenCV) to the scene's world frame (Z up); or give "
    "it in the scene's file (docs/how-to/rescue-meshes.md)"
)


class MeshScene(NamedTuple):
    """Objects of a scene file, with their poses in the world frame (Z up)."""

    objects: list[Assembly]
    camera: FileCamera | None = None
    """Camera of the photograph; None if the file states no camera."""
    in_camera: bool = False
    """True if the poses in the file are in the camera's frame. The world frame is then the result
    of `level_transform`."""


class PosedFile(Spec):
    """Object in a poses.json."""

    file: Annotated[str, Field(max_length=400)]
    """Mesh, URDF or MJCF file below the folder of poses.json."""
    pose: Rows
    """Rows of the transform from the file's frame, [4, 4]; it must be rigid unless the file is a
    mesh."""
    fixed: bool = False
    """If True, the object cannot move."""


class PosedFiles(Spec):
    """Contents of poses.json."""

    frame: Literal["world", "camera"] = "world"
    up: Vec3 = (0.0, -1.0, 0.0)
    """Vector that points up in the camera's frame; ignored if `frame` is "world"."""
    camera: FileCamera | None = None
    objects: dict[str, PosedFile] = Field(min_length=1, max_length=MAX_NODES)


def read_mesh_scene(path: Path) -> MeshScene:
    """Read a poses.json.

    Raises:
        SpecError: the file is broken or hostile, or refers to a file that is missing or outside
            its folder.
    """
    posed = read_model(path, PosedFiles, SpecError, "a list of posed files")
    in_camera, camera, to_world = posed.frame == "camera", posed.camera, np.eye(4)
    if in_camera:
        if camera is not None and camera.pose is not None:
            raise SpecError(f'{path}: with "frame": "camera", "camera" cannot have a "pose"')
        try:
            to_world = level_transform(np.array(posed.up))
        except EvidenceError as error:
            raise SpecError(f"{path}: {error}") from None
        camera = FileCamera(pose=rows_of(to_world)).completed_by(camera)
    objects = [_posed(path, name, item, to_world) for name, item in posed.objects.items()]
    return MeshScene(objects, camera, in_camera)


def mesh_object(
    name: str,
    meshes: Sequence[Triangles],
    transform: NDArray,
    *,
    fixed: bool = False,
) -> Assembly:
    """Return meshes at a pose as one rigid object, whose colliders are derived from the meshes.

    Args:
        name: name of the object.
        meshes: vertices and faces of each mesh, in the object's frame.
        transform: affine transform from the object's frame to the world frame, shape [4, 4]; its
            scale is applied to the meshes.
        fixed: if True, the object cannot move.

    Raises:
        SpecError: the transform is singular or not affine.
    """
    linear = transform[:3, :3]
    u, scales, v = np.linalg.svd(linear)
    if not np.isfinite(transform).all() or not np.allclose(transform[3], [0, 0, 0, 1]):
        raise SpecError(f"object {name[:40]}: its pose is not an affine transform")
    if scales[-1] < 1e-6 * max(scales[0], 1e-6):
        raise SpecError(f"object {name[:40]}: its pose is singular")
    # If the transform mirrors, the mesh is mirrored, and the rotation remains proper.
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation, transform[:3, 3]
    turn = 1 if np.linalg.det(linear) > 0 else -1
    local = [(vertices @ (rotation.T @ linear).T, faces[:, ::turn]) for vertices, faces in meshes]
    visuals = [LinkShape(triangles, np.eye(4), "visual") for triangles in local]
    link = Link("body", visuals, visual_only=True)
    return Assembly(name, Mechanism(name, {"body": link}, []), frame, fixed)


def _posed(path: Path, name: str, item: PosedFile, to_world: NDArray) -> Assembly:
    file, transform = inside(path, item.file), to_world @ np.array(item.pose)
    if file.suffix.lower() in SUFFIXES:
        return mesh_object(name, [load_mesh(file)], transform, fixed=item.fixed)
    mechanism = _mechanism(file)
    # The file contains only this object, whereas `path` contains several.
    notes = [*mechanism.file_notes, *mechanism.notes]
    mechanism = replace(mechanism, name=name, notes=notes, file_notes=[])
    rotation = transform[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0:
        raise SpecError(f"{path}, object {name[:40]}: the pose of a model must be rigid")
    return Assembly(name, mechanism, transform, item.fixed)


def _mechanism(file: Path) -> Mechanism:
    from .read_mjcf import read_mjcf
    from .read_urdf import read_urdf

    suffix = file.suffix.lower()
    if suffix in (".urdf", ".xacro"):
        return read_urdf(file)
    if suffix in (".xml", ".mjcf"):
        return read_mjcf(file)
    raise SpecError(f"{file}: objects are meshes ({', '.join(SUFFIXES)}), URDF or MJCF files")


GLTF = (".glb", ".gltf")
Z_UP = Y_UP.T
"""Transform from glTF's axes (Y up) to axes with Z up."""


def read_gltf(path: Path) -> MeshScene:
    """Read the objects and the first perspective camera of a text or binary glTF file.

    Raises:
        SpecError: the file is broken or hostile.
    """
    import trimesh

    data = mesh_bytes(path)
    try:
        loaded: Any = trimesh.load(
            io.BytesIO(data),
            file_type=path.suffix.lower()[1:],
            resolver=folder_buffers(path),
            force="scene",
            process=False,
            skip_materials=True,
        )
        count = len(loaded.graph.nodes_geometry)
        if not 0 < count <= MAX_NODES:
            raise SpecError(f"{path} has {count} meshes in its nodes; expected 1 to {MAX_NODES}")
        posed = [_meshes_below(loaded, node) for node in _object_nodes(loaded.graph)]
        camera = _gltf_camera(gltf_document(data))
    except SpecError:
        raise
    except Exception as error:  # trimesh raises errors of many types
        raise SpecError(f"{path} is not glTF: {type(error).__name__}: {error}"[:300]) from None
    objects = [mesh_object(name, meshes, transform) for name, meshes, transform in posed if meshes]
    return MeshScene(objects, camera)


def _object_nodes(graph: Any) -> list[Any]:
    """Return the nodes of a glTF scene that represent objects.

    An object consists of all meshes in and below its node. The search for objects begins at the
    root of the scene. It descends by a level as long as the current level has a single node with
    meshes in or below it, this node has no mesh, and the node's extras do not mark it as an object.
    """
    meshed, tree = set(graph.nodes_geometry), graph.transforms
    level = [graph.base_frame]
    while len(level) == 1 and level[0] not in meshed:
        extras = tree.edge_data.get((tree.parents.get(level[0]), level[0]), {}).get("metadata")
        if extras and OBJECT_EXTRAS.items() <= extras.items():
            break
        level = [node for node in tree.children.get(level[0], []) if meshed & tree.successors(node)]
    return level


def _meshes_below(loaded: Any, node: Any) -> tuple[str, list[Triangles], NDArray]:
    """Return the name of a node, and the meshes in and below it with their pose.

    The meshes are in the node's frame with Z up. The pose is the affine transform from this frame
    to the world frame, shape [4, 4].
    """
    below = loaded.graph.transforms.successors(node)
    meshes = []
    for inner in (n for n in loaded.graph.nodes_geometry if n in below):
        transform, key = loaded.graph.get(inner, frame_from=node)
        mesh = loaded.geometry[key]
        if hasattr(mesh, "faces"):  # Points and lines are skipped.
            # Copy, because nodes may share a mesh, and a mirroring transform reverses its faces.
            upright = mesh.copy().apply_transform(Z_UP @ np.asarray(transform, float))
            vertices, faces = np.array(upright.vertices, float), np.array(upright.faces, np.int64)
            meshes.append(merged_vertices(vertices, faces))
    return str(node), meshes, Z_UP @ np.asarray(loaded.graph[node][0], float) @ Z_UP.T


def _gltf_camera(document: dict[str, Any]) -> FileCamera | None:
    """Return the first perspective camera of a glTF file.

    The result is None if there is no such camera, or if the transform of its node mirrors or is
    singular. trimesh itself reads only cameras that are children of the root and state their aspect
    ratio.
    """
    nodes = document.get("nodes", [])
    parents = {child: k for k, node in enumerate(nodes) for child in node.get("children", [])}
    for k, node in enumerate(nodes):
        lens = document["cameras"][node["camera"]].get("perspective") if "camera" in node else None
        if lens is None:
            continue
        pose, above = TO_OPENCV, k
        while above is not None:
            pose, above = _local(nodes[above]) @ pose, parents.pop(above, None)
        pose = Z_UP @ pose
        u, scales, v = np.linalg.svd(pose[:3, :3])
        if scales[-1] < 1e-9 or np.linalg.det(u @ v) < 0:
            return None
        # Scales of the nodes above the camera do not change the camera's image.
        pose[:3, :3] = u @ v
        return FileCamera(pose=rows_of(pose), fovy=float(lens["yfov"]))
    return None


def _local(node: dict[str, Any]) -> NDArray:
    """Return the transform from a glTF node (with a matrix, or T R S) to its parent, [4, 4]."""
    from trimesh import transformations

    if "matrix" in node:
        return np.reshape(np.asarray(node["matrix"], float), (4, 4)).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = transformations.quaternion_matrix([w, x, y, z])
    turn[:3, :3] *= np.asarray(node.get("scale", (1.0, 1.0, 1.0)), float)
    turn[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return turn

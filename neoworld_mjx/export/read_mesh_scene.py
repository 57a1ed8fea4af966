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

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..errors import EvidenceError, SpecError
from ..evidence.file_camera import (
    TO_OPENCV,
    FileCamera,
    Rows,
    level_transform,
    rows_of,
)
from ..io import read_model
from ..io.names import identifier
from ..quantities import count
from ..spec import Spec
from ..spec.base import Vec3
from .asset_files import inside
from .gltf_file import (
    MAX_NODES,
    GltfFile,
    broken,
    moved,
    node_matrix,
    node_surfaces,
    nodes_below,
    parents_of,
    read_gltf_file,
    roots_of,
)
from .load_mesh import SUFFIXES, load_surfaces, merged_vertices
from .mechanism import Assembly, FileScene, Link, Mechanism, visual_shapes
from .mesh_colors import Surface
from .write_glb import OBJECT_EXTRAS, Y_UP

POSES = "poses.json"


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


def read_mesh_scene(path: Path) -> FileScene:
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
    return FileScene(objects, camera=camera, in_camera=in_camera)


def read_mesh(path: Path) -> FileScene:
    """Read a mesh file as one rigid object, in meters with Z up.

    Raises:
        SpecError: the file is not a mesh, or too large.
    """
    notes = ["read in meters, with z up and the front at +x"]
    surfaces = load_surfaces(path, notes)
    name = identifier(path.stem, "object")
    assembly = mesh_object(name, surfaces, np.eye(4), groups=[0] * len(surfaces))
    assembly.mechanism.notes += notes
    return FileScene([assembly])


def mesh_object(
    name: str,
    surfaces: Sequence[Surface],
    transform: NDArray,
    *,
    fixed: bool = False,
    groups: Sequence[int] = (),
) -> Assembly:
    """Return meshes at a pose as one rigid object, whose colliders are derived from the meshes.

    Args:
        name: name of the object.
        surfaces: surfaces of the meshes in the object's frame.
        transform: affine transform from the object's frame to the world frame, shape [4, 4]; its
            scale is applied to the meshes.
        fixed: if True, the object cannot move.
        groups: number of the mesh that each surface is a part of; by default, each is a mesh.

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
    frame, local = np.eye(4), np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation, transform[:3, 3]
    local[:3, :3] = rotation.T @ linear
    shapes = visual_shapes(
        [moved(surface, local) for surface in surfaces],
        np.eye(4),
        groups or range(len(surfaces)),
    )
    link = Link("body", shapes)
    return Assembly(name, Mechanism(name, {"body": link}, []), frame, fixed)


def _posed(path: Path, name: str, item: PosedFile, to_world: NDArray) -> Assembly:
    file, transform = inside(path, item.file), to_world @ np.array(item.pose)
    if file.suffix.lower() in SUFFIXES:
        notes: list[str] = []
        surfaces = load_surfaces(file, notes)
        groups = [0] * len(surfaces)
        result = mesh_object(name, surfaces, transform, fixed=item.fixed, groups=groups)
        result.mechanism.notes += notes
        return result
    mechanism = _mechanism(file)
    # The file contains only this object, whereas `path` contains several.
    notes = [*mechanism.file_notes, *mechanism.notes]
    # The list of poses says which objects are fixed.
    mechanism = replace(mechanism, name=name, notes=notes, file_notes=[], fixed=False)
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


Z_UP = Y_UP.T
"""Transform from glTF's axes (Y up) to axes with Z up."""


def read_gltf(path: Path) -> FileScene:
    """Read the objects and the first perspective camera of a text or binary glTF file.

    Raises:
        SpecError: the file is broken or hostile, or requires an extension that is not read.
    """
    try:
        file = read_gltf_file(path)
        shown = nodes_below(file, roots_of(file))
        meshed = {k for k in shown if "mesh" in file.rows("nodes")[k]}
        if not 0 < len(meshed) <= MAX_NODES:
            raise SpecError(
                f"{path} has {len(meshed)} meshes in its nodes; expected 1 to {MAX_NODES}"
            )
        objects = [_gltf_object(file, node) for node in _object_nodes(file, meshed)]
        camera = _gltf_camera(file)
    except (SpecError, MemoryError):
        raise
    except Exception as error:  # Broken files cause errors of many types.
        raise broken(path, error) from None
    found = [item for item in objects if item is not None]
    if not found:
        raise SpecError(f"{path} has no triangles")
    if animations := file.rows("animations"):
        found[0].mechanism.file_notes.append(f"{count(animations, 'animation')} not imported")
    return FileScene(found, camera=camera)


def _object_nodes(file: GltfFile, meshed: set[int]) -> list[int]:
    """Return the nodes of a glTF scene that represent objects.

    An object consists of all meshes in and below its node. The search for objects begins at the
    roots of the scene. It descends by a level as long as the current level has a single node with
    meshes in or below it, this node has no mesh, and the node's extras do not mark it as an object.
    """
    nodes, level = file.rows("nodes"), roots_of(file)
    while True:
        level = [node for node in level if meshed & set(nodes_below(file, [node]))]
        if len(level) != 1 or level[0] in meshed:
            return level
        extras = nodes[level[0]].get("extras")
        if isinstance(extras, dict) and OBJECT_EXTRAS.items() <= extras.items():
            return level
        level = nodes[level[0]].get("children", [])


def _gltf_object(file: GltfFile, top: int) -> Assembly | None:
    """Return the meshes in and below a node as an object; None if there are no triangles."""
    parents, row, notes = parents_of(file), file.rows("nodes")[top], list[str]()
    surfaces = [
        (node, moved(surface, Z_UP @ node_matrix(file, parents, node, top)))
        for node in nodes_below(file, [top])
        for surface in node_surfaces(file, node, notes)
    ]
    merged = [
        (node, surface._replace(vertices=vertices, faces=faces))
        for node, surface in surfaces
        for vertices, faces in [merged_vertices(surface.vertices, surface.faces)]
        if len(faces)
    ]
    if not merged:
        return None
    mesh_name = file.rows("meshes")[row["mesh"]].get("name") if "mesh" in row else None
    name = str(row.get("name") or mesh_name or f"node_{top}")
    pose = Z_UP @ node_matrix(file, parents, top) @ Z_UP.T
    result = mesh_object(name, [s for _, s in merged], pose, groups=[node for node, _ in merged])
    result.mechanism.notes += dict.fromkeys(notes)
    return result


def _gltf_camera(file: GltfFile) -> FileCamera | None:
    """Return the first perspective camera of a glTF file.

    The result is None if there is no such camera, or if the transform of its node mirrors or is
    singular.
    """
    for k, node in enumerate(file.rows("nodes")):
        lens = file.rows("cameras")[node["camera"]].get("perspective") if "camera" in node else None
        if lens is None:
            continue
        pose = Z_UP @ node_matrix(file, parents_of(file), k) @ TO_OPENCV
        u, scales, v = np.linalg.svd(pose[:3, :3])
        if scales[-1] < 1e-9 or np.linalg.det(u @ v) < 0:
            return None
        # Scales of the nodes above the camera do not change the camera's image.
        pose[:3, :3] = u @ v
        return FileCamera(pose=rows_of(pose), fovy=float(lens["yfov"]))
    return None

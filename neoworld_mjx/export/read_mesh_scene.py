"""Read scenes of posed meshes: glTF files, and files of poses next to meshes or models.

    SCENE.glb, SCENE.gltf    a node with a mesh is an object; meters, Y up (glTF 2.0)
    poses.json               {"frame": "world", "objects": {"mug": {"file": "mug.obj",
                              "pose": [[4x4]], "fixed": false}}}

Poses map the frame of an object's file to the world (Z up), or with "frame": "camera" to that of a
camera (OpenCV: x right, y down, z ahead); "up" then gives the vertical in it.
"""

import io
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..errors import SpecError
from ..io import read_model
from ..spec import Spec
from ..spec.base import Number, Vec3
from .checked_xml import inside
from .load_mesh import (
    SUFFIXES,
    check_claims,
    folder_buffers,
    load_mesh,
    merged_vertices,
    mesh_bytes,
)
from .mechanism import Assembly, Link, LinkShape, Mechanism

GLTF = (".glb", ".gltf")
POSES = "poses.json"
MAX_NODES = 500
Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Transform from glTF's axes (Y up) to those with Z up."""
CAMERA_TO_WORLD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Transform from OpenCV's camera axes to x ahead, y to the left, z up."""
GRAVITY = 9.81
Row = tuple[Number, Number, Number, Number]


class PosedFile(Spec):
    """An object of a poses.json."""

    file: Annotated[str, Field(max_length=400)]
    """Mesh, URDF, MJCF or USD file below the folder of poses.json."""
    pose: tuple[Row, Row, Row, Row]
    """Transform of the file's frame, row by row; it may scale a mesh."""
    fixed: bool = False
    """True if the object cannot move."""


class PosedFiles(Spec):
    """Contents of poses.json."""

    frame: Literal["world", "camera"] = "world"
    up: Vec3 = (0.0, -1.0, 0.0)
    """The vertical in the camera's frame; of no effect in the world."""
    objects: dict[str, PosedFile] = Field(min_length=1, max_length=MAX_NODES)


def read_mesh_scene(path: Path) -> tuple[list[Assembly], Vec3 | None]:
    """Read a glTF scene or a poses.json.

    Returns:
        The objects, and the gravity [m/s^2] where the file states the vertical.

    Raises:
        SpecError: the file is broken or hostile, or names a file that is missing or lies outside
            its folder.
    """
    if path.suffix.lower() in GLTF:
        return _gltf_objects(path), None
    posed = read_model(path, PosedFiles, SpecError, "a list of posed files")
    into = CAMERA_TO_WORLD if posed.frame == "camera" else np.eye(4)
    objects = [_posed(path, name, item, into) for name, item in posed.objects.items()]
    if posed.frame == "world":
        return objects, None
    up = CAMERA_TO_WORLD[:3, :3] @ np.array(posed.up)
    if np.linalg.norm(up) < 1e-6:
        raise SpecError(f"{path}: up must not be zero")
    down = -GRAVITY * up / np.linalg.norm(up)
    return objects, (float(down[0]), float(down[1]), float(down[2]))


def mesh_object(
    name: str, vertices: NDArray, faces: NDArray, transform: NDArray, *, fixed: bool = False
) -> Assembly:
    """Return a mesh [v, 3] m, [f, 3] at a pose as an object; its colliders are derived from it.

    Args:
        name: of the object.
        vertices: vertices in the mesh's own frame.
        faces: triangles.
        transform: affine transform [4, 4] to the world; its scale is applied to the mesh.
        fixed: True if the object cannot move.

    Raises:
        SpecError: the transform is singular or not affine.
    """
    linear = transform[:3, :3]
    u, scales, v = np.linalg.svd(linear)
    if not np.isfinite(transform).all() or not np.allclose(transform[3], [0, 0, 0, 1]):
        raise SpecError(f"object {name[:40]}: its pose is no affine transform")
    if scales[-1] < 1e-6 * max(scales[0], 1e-6):
        raise SpecError(f"object {name[:40]}: its pose is singular")
    # A pose that mirrors keeps the rotation's handedness; the mesh is mirrored.
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation, transform[:3, 3]
    local = vertices @ (rotation.T @ linear).T
    outward = faces if np.linalg.det(linear) > 0 else faces[:, ::-1]
    shape = LinkShape((local, outward), np.eye(4), "visual")
    link = Link("body", [shape], visual_only=True)
    return Assembly(name, Mechanism(name, {"body": link}, []), frame, fixed)


def _posed(path: Path, name: str, item: PosedFile, into: NDArray) -> Assembly:
    file, transform = inside(path, item.file), into @ np.array(item.pose)
    if file.suffix.lower() in SUFFIXES:
        return mesh_object(name, *load_mesh(file), transform, fixed=item.fixed)
    mechanism = _mechanism(file)
    mechanism.name = name
    rotation = transform[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0:
        raise SpecError(f"{path}, object {name[:40]}: the pose of a model must be rigid")
    return Assembly(name, mechanism, transform, item.fixed)


def _mechanism(file: Path) -> Mechanism:
    from .checked_usd import SUFFIXES as USD
    from .checked_usd import open_usd
    from .read_mjcf import read_mjcf
    from .read_urdf import read_urdf
    from .read_usd import one_object

    suffix = file.suffix.lower()
    if suffix in (".urdf", ".xacro"):
        return read_urdf(file)
    if suffix in (".xml", ".mjcf"):
        return read_mjcf(file)
    if suffix in USD:
        return one_object(file, open_usd(file), None)
    raise SpecError(f"{file}: objects are meshes ({', '.join(SUFFIXES)}), URDF, MJCF or USD files")


def _gltf_objects(path: Path) -> list[Assembly]:
    import trimesh

    data = mesh_bytes(path)
    check_claims(path, path.suffix.lower(), data)
    try:
        loaded: Any = trimesh.load(
            io.BytesIO(data),
            file_type=path.suffix.lower()[1:],
            resolver=folder_buffers(path),
            force="scene",
            process=False,
            skip_materials=True,
        )
        nodes = list(loaded.graph.nodes_geometry)
        posed = [(str(node), *loaded.graph[node]) for node in nodes[: MAX_NODES + 1]]
        meshes = {key: mesh for key, mesh in loaded.geometry.items() if hasattr(mesh, "faces")}
    except SpecError:
        raise
    except Exception as error:  # trimesh raises errors of many types
        raise SpecError(f"{path} is not glTF: {type(error).__name__}: {error}"[:300]) from None
    if not 0 < len(nodes) <= MAX_NODES:
        raise SpecError(
            f"{path} has {len(nodes)} meshes in its nodes; expected are 1 to {MAX_NODES}"
        )
    objects = []
    for name, transform, key in posed:
        if key not in meshes:
            continue  # Points and lines are no objects.
        vertices, faces = merged_vertices(
            np.array(meshes[key].vertices, float), np.array(meshes[key].faces, np.int64)
        )
        turned = Z_UP @ np.asarray(transform, float) @ Z_UP.T
        objects.append(mesh_object(name, vertices @ Z_UP[:3, :3].T, faces, turned))
    return objects

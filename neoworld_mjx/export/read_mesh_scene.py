"""Read scenes of posed meshes: glTF files, and files of poses next to meshes or models.

    SCENE.glb, SCENE.gltf    a node with a mesh is an object; meters, Y up (glTF 2.0)
    poses.json               {"frame": "world", "objects": {"mug": {"file": "mug.obj",
                              "pose": [[4x4]], "fixed": false}}, "camera": {...}}

Poses map the frame of an object's file to the world (Z up), or with "frame": "camera" to that of a
camera (OpenCV: x right, y down, z ahead); "up" then gives the vertical in it, by which the scene is
leveled. The camera of the photograph is that frame, "camera" (`FileCamera`), or glTF's camera.
"""

import io
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..errors import SpecError
from ..io import read_model
from ..spec import Spec
from ..spec.base import Vec3
from .checked_xml import inside
from .file_camera import FileCamera, Row, leveled
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
TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Transform from OpenCV's camera axes to glTF's (x right, y up, z back), and back."""


class MeshScene(NamedTuple):
    """Objects of a scene file, at their poses in its world, Z up."""

    objects: list[Assembly]
    camera: FileCamera | None = None
    """Camera of the photograph, if the file states one."""
    in_camera: bool = False
    """True if the poses were in the camera's frame: the world is that of the leveled camera."""


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
    camera: FileCamera | None = None
    objects: dict[str, PosedFile] = Field(min_length=1, max_length=MAX_NODES)


def read_mesh_scene(path: Path) -> MeshScene:
    """Read a glTF scene or a poses.json.

    Raises:
        SpecError: the file is broken or hostile, or names a file that is missing or lies outside
            its folder.
    """
    if path.suffix.lower() in GLTF:
        return _gltf_scene(path)
    posed = read_model(path, PosedFiles, SpecError, "a list of posed files")
    in_camera, camera, into = posed.frame == "camera", posed.camera, np.eye(4)
    if in_camera:
        if camera is not None and camera.pose is not None:
            raise SpecError(f'{path}: poses with "frame": "camera" leave the camera no "pose"')
        try:
            into = leveled(np.array(posed.up))
        except SpecError as error:
            raise SpecError(f"{path}: {error}") from None
        camera = FileCamera(pose=_rows(into)).completed_by(camera)
    objects = [_posed(path, name, item, into) for name, item in posed.objects.items()]
    return MeshScene(objects, camera, in_camera)


def _rows(matrix: NDArray) -> tuple[Row, Row, Row, Row]:
    a, b, c, d = (tuple(row) for row in np.asarray(matrix, float).tolist())
    return a, b, c, d


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


def _gltf_camera(loaded: Any) -> FileCamera | None:
    """Return the camera of a glTF scene; None for one whose node mirrors or is singular."""
    pose = Z_UP @ np.asarray(loaded.camera_transform, float) @ TO_OPENCV
    u, scales, v = np.linalg.svd(pose[:3, :3])
    # Scales of the nodes above the camera have no effect on what it sees.
    pose[:3, :3] = u @ v
    if scales[-1] < 1e-9 or np.linalg.det(u @ v) < 0:
        return None
    return FileCamera(pose=_rows(pose), fovy=float(np.radians(loaded.camera.fov[1])))


def _gltf_scene(path: Path) -> MeshScene:
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
        camera = _gltf_camera(loaded) if loaded.has_camera else None
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
    return MeshScene(objects, camera)

"""Reads scenes of posed meshes or models from a file that lists their poses.

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
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..errors import SpecError
from ..io import read_model
from ..spec import Spec
from ..spec.base import Vec3
from .checked_xml import inside
from .file_camera import FileCamera, Row, level_transform
from .load_mesh import (
    SUFFIXES,
    load_mesh,
)
from .mechanism import Assembly, Link, LinkShape, Mechanism, Triangles

POSES = "poses.json"
MAX_NODES = 500


class MeshScene(NamedTuple):
    """Objects of a scene file, with their poses in the world frame (Z up)."""

    objects: list[Assembly]
    camera: FileCamera | None = None
    """Camera of the photograph; None if the file states no camera."""
    in_camera: bool = False
    """True if the poses in the file are in the camera's frame. The world frame is then the result
    of `file_camera.level_transform`."""


class PosedFile(Spec):
    """Object in a poses.json."""

    file: Annotated[str, Field(max_length=400)]
    """Mesh, URDF or MJCF file below the folder of poses.json."""
    pose: tuple[Row, Row, Row, Row]
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
        except SpecError as error:
            raise SpecError(f"{path}: {error}") from None
        camera = FileCamera(pose=rows_of(to_world)).completed_by(camera)
    objects = [_posed(path, name, item, to_world) for name, item in posed.objects.items()]
    return MeshScene(objects, camera, in_camera)


def rows_of(matrix: NDArray) -> tuple[Row, Row, Row, Row]:
    """Return the rows of a 4 x 4 matrix as tuples."""
    a, b, c, d = (tuple(row) for row in np.asarray(matrix, float).tolist())
    return a, b, c, d


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

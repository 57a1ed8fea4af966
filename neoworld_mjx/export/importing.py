"""Imports URDF, MJCF and glTF files, and posed meshes, as objects and scenes.

Readers of these formats return mechanisms, which are converted to ObjectSpecs with notes on
omissions. All files are read in a limited worker.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from ..errors import SpecError
from ..evidence.file_camera import FileCamera
from ..io.limited_worker import call_limited
from ..io.names import identifier
from ..io.text_files import validation_message
from ..spec import (
    SceneObject,
    SceneSpec,
)
from ..spec.base import Vec3
from ..spec.pose import conjugate, from_matrix, from_yaw, quat_mul, yaw_of
from .asset_files import read_xml
from .gltf_file import GLTF
from .load_mesh import SUFFIXES as MESHES
from .mechanism import (
    GRAVITY,
    Assembly,
    FileScene,
    gravity_notes,
    transformed,
)
from .object_of_mechanism import Imported, budget_of, to_object
from .read_mesh_scene import POSES, read_gltf, read_mesh, read_mesh_scene
from .read_mjcf import read_mjcf_scene
from .read_urdf import read_urdf

FILES = (".urdf", ".xacro", ".xml", ".mjcf", *GLTF)
"""Suffixes of the files that can be imported."""
USD = (".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of USD files, which are refused with the names of converters."""
MAX_OBJECTS = 500
MESH_READERS = ("trimesh", "yourdfpy")
"""Modules that `read_urdf` imports when it is called."""


@dataclass(frozen=True)
class ImportedScene:
    """Scene imported from a file."""

    spec: SceneSpec
    notes: tuple[str, ...]
    """Notes on data that the import omits, and on assumptions that it makes."""
    camera: FileCamera | None = None
    """Camera of the photograph; None unless a scene of meshes states one."""
    in_camera: bool = False
    """True if the poses in the file are relative to `camera`; `spec` is rotated so that z is up."""


def import_file(path: Path) -> Imported | ImportedScene:
    """Read a URDF or MJCF file: an object if the file contains only one, otherwise a scene.

    A glTF file (`read_gltf`), a mesh or a poses.json (`read_mesh_scene`) is always read as a scene.

    Raises:
        SpecError: the format is not supported, or the file is broken or hostile, refers to a file
            that is missing or outside its folder, or exceeds the limits on size.
    """
    path = Path(path)
    try:
        read = call_limited(_read, path, needs=MESH_READERS)
        if read.gravity is not None and len(read.objects) == 1:
            return _lone_object(read.objects[0], read.gravity)
        scene = scene_of_assemblies(path, read.objects)
        stated = {} if read.gravity is None else {"gravity": read.gravity}
        spec = scene.spec.model_copy(update=stated)
        return replace(scene, spec=spec, camera=read.camera, in_camera=read.in_camera)
    except SpecError as error:
        message = str(error)
        raise SpecError(message if path.name in message else f"{path}: {message}") from None


def _read(path: Path) -> FileScene:
    """Read all objects of a file, and the camera that the file states."""
    if path.suffix.lower() in GLTF:
        return read_gltf(path)
    if path.name == POSES:
        return read_mesh_scene(path)
    if path.suffix.lower() in MESHES:
        return read_mesh(path)
    if path.suffix.lower() in USD:
        raise SpecError(
            f"{path}: USD is written, not read; convert it to MJCF, URDF or glTF first (for "
            "example by Isaac Sim's URDF exporter, or by Blender's import of USD and export of "
            "glTF)"
        )
    try:
        root = read_xml(path)
    except SpecError as error:
        if path.suffix.lower() in FILES:
            raise
        supported = ", ".join((*FILES, POSES))
        raise SpecError(f"{error}; files that can be read: {supported}") from None
    if root.tag == "robot":
        return FileScene([Assembly("/", read_urdf(path), np.eye(4))], GRAVITY)
    if root.tag == "mujoco":
        return read_mjcf_scene(path)
    raise SpecError(
        f"{path}: the root element is <{root.tag}>; expected <robot> (URDF) or <mujoco> (MJCF)"
    )


def _lone_object(assembly: Assembly, gravity: Vec3) -> Imported:
    """Return the only object of a file, with notes on what the file states of its surroundings."""
    mechanism = transformed(assembly.mechanism, assembly.frame)
    imported = replace(to_object(mechanism), gravity=gravity)
    notes = [*imported.notes]
    if imported.fixed_base:
        place = ", ".join(f"{round(v, 4) + 0.0:g}" for v in imported.origin)
        notes.append(f"the base is fixed to the world at ({place}) m")
    notes += gravity_notes(gravity)
    return replace(imported, notes=tuple(notes))


def scene_of_assemblies(path: Path, assemblies: list[Assembly]) -> ImportedScene:
    """Return a scene of the objects of a file.

    Args:
        path: the file; the scene takes its name, and messages refer to it.
        assemblies: the objects, with their poses in the world frame.

    Raises:
        SpecError: there are too many objects, or a number is out of bounds.
    """
    if len(assemblies) > MAX_OBJECTS:
        raise SpecError(f"{path} has {len(assemblies)} objects; the limit is {MAX_OBJECTS}")
    objects: list[SceneObject] = []
    notes: list[str] = []
    budget = budget_of([assembly.mechanism for assembly in assemblies])
    for assembly in assemblies:
        imported = to_object(assembly.mechanism, budget)
        name = identifier(imported.spec.name, "object", {item.name for item in objects})
        notes += [
            note if note in imported.file_notes else f"{name}: {note}" for note in imported.notes
        ]
        objects.append(_scene_object(name, assembly, imported))
    name = identifier(path.stem, "scene")
    try:
        scene = SceneSpec(name=name, objects=tuple(objects))
    except ValidationError as error:
        raise SpecError(f"{path}: {validation_message(error, SceneSpec)}") from None
    return ImportedScene(scene, tuple(dict.fromkeys(notes)))


def import_object(path: Path) -> Imported:
    """Read a URDF or MJCF file with one object, and possibly a floor and other surroundings.

    Raises:
        SpecError: the file has another format, contains several objects, is malformed, or exceeds
            the limits on size.
    """
    imported = import_file(path)
    if isinstance(imported, ImportedScene):
        lone = only_object(imported)
        if lone is not None:
            return lone
        names = ", ".join(item.name for item in imported.spec.objects[:8])
        raise SpecError(f"{path} contains several objects instead of one: {names}")
    return imported


def only_object(scene: ImportedScene) -> Imported | None:
    """Return the object of a scene that contains nothing else but fixed surroundings, or None."""
    items = [item for item in scene.spec.objects if not item.environment]
    if len(items) != 1:
        return None
    (item,) = items
    rest = ", ".join(other.name for other in scene.spec.objects if other.environment)
    notes = [*scene.notes, f"only {item.name} is used, without its surroundings: {rest}"]
    return Imported(item.spec, tuple(notes), fixed_base=item.fixed_base)


def _scene_object(name: str, assembly: Assembly, imported: Imported) -> SceneObject:
    """Return an object at the pose that the file states, without a parent."""
    spec = imported.spec
    x, y, z, _ = (assembly.frame @ np.array([*imported.origin, 1.0])).tolist()
    quat = from_matrix(assembly.frame[:3, :3])
    yaw = yaw_of(quat)
    tilt = quat_mul(conjugate(from_yaw(yaw)), quat)
    state = {}
    for key, value in assembly.state.items():
        joint, dot, axis = key.partition(".")
        if joint in imported.joints:
            state[f"{imported.joints[joint]}{dot}{axis}"] = value
    moves = any(joint.type != "fixed" for joint in spec.joints)
    fixed = assembly.fixed or imported.fixed_base
    return SceneObject(
        name=name,
        spec=spec,
        environment=fixed and not moves,
        fixed_base=fixed and moves,
        xy=(x, y),
        z=z,
        yaw=yaw,
        base_tilt=tuple((tilt / np.linalg.norm(tilt)).tolist()),
        joint_state=state,
    )

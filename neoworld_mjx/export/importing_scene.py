"""Turn files of other programs that hold one object or many into an ObjectSpec or a SceneSpec."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from ..errors import SpecError
from ..io.names import identifier
from ..io.validation_message import validation_message
from ..spec import SceneObject, SceneSpec
from ..spec.base import Vec3
from ..spec.pose import conjugate, from_matrix, from_yaw, quat_mul, yaw_of
from .checked_usd import SUFFIXES, open_usd
from .checked_xml import read_xml
from .importing import Imported, import_urdf, to_object
from .mechanism import Assembly, transformed
from .read_mjcf import read_mjcf_scene
from .read_usd import gravity_of, read_assemblies

FILES = (".urdf", ".xacro", ".xml", ".mjcf", *SUFFIXES)
"""Suffixes of files of other programs."""
MAX_OBJECTS = 500


@dataclass(frozen=True)
class ImportedScene:
    """A scene read from a file of another program."""

    spec: SceneSpec
    notes: tuple[str, ...]
    """Omissions and assumptions, in words."""


def import_file(path: Path) -> Imported | ImportedScene:
    """Read a URDF, MJCF or USD file: an object where it holds one, else a scene.

    Raises:
        SpecError: the file is of no such kind, is broken or hostile, names a file that is not there
            or lies outside its folder, or exceeds the limits on size.
    """
    path = Path(path)
    try:
        if path.suffix.lower() in SUFFIXES:
            stage = open_usd(path)
            made = read_assemblies(path, stage, apart=True)
            return _described(path, made, gravity_of(stage))
        root = read_xml(path)
        if root.tag == "robot":
            return import_urdf(path)
        if root.tag == "mujoco":
            return _described(path, read_mjcf_scene(path), None)
    except SpecError as error:
        message = str(error)
        raise SpecError(message if path.name in message else f"{path}: {message}") from None
    raise SpecError(
        f"{path} begins with <{root.tag}>: a URDF begins with <robot>, an MJCF with <mujoco>"
    )


def _described(path: Path, made: list[Assembly], gravity: Vec3 | None) -> Imported | ImportedScene:
    bodies = [one for one in made if not one.bare]
    if len(made) == 1:
        return to_object(transformed(made[0].mechanism, made[0].frame))
    if len(bodies) > MAX_OBJECTS:
        raise SpecError(f"{path} holds {len(bodies)} objects; at most {MAX_OBJECTS} are read")
    objects: list[SceneObject] = []
    notes: list[str] = []
    for one in made:
        imported = to_object(one.mechanism)
        name = identifier(imported.spec.name, "object", {item.name for item in objects})
        notes += [note if _is_general(note) else f"{name}: {note}" for note in imported.notes]
        objects.append(_placed(name, one, imported))
    name = identifier(path.stem, "scene")
    try:
        scene = SceneSpec(name=name, objects=tuple(objects))
        if gravity is not None:
            scene = scene.model_copy(update={"gravity": gravity})
    except ValidationError as error:
        raise SpecError(f"{path}: {validation_message(error, SceneSpec)}") from None
    return ImportedScene(scene, tuple(dict.fromkeys(notes)))


def _is_general(note: str) -> bool:
    return "imported" in note and "link" not in note and "joint" not in note


def _placed(name: str, one: Assembly, imported: Imported) -> SceneObject:
    """Put an object where its file has it, without a parent."""
    spec = imported.spec
    at = one.frame @ np.array([*imported.origin, 1.0])
    turn = from_matrix(one.frame[:3, :3])
    yaw = yaw_of(turn)
    tilt = quat_mul(conjugate(from_yaw(yaw)), turn)
    state = {}
    for key, value in one.state.items():
        joint, dot, axis = key.partition(".")
        if joint in imported.joints:
            state[f"{imported.joints[joint]}{dot}{axis}"] = value
    moves = any(joint.type != "fixed" for joint in spec.joints)
    return SceneObject(
        name=name,
        spec=spec,
        environment=one.fixed and not moves,
        fixed_base=one.fixed and moves,
        xy=(float(at[0]), float(at[1])),
        z=float(at[2]),
        yaw=yaw,
        base_tilt=tuple((tilt / np.linalg.norm(tilt)).tolist()),
        joint_state=state,
    )

"""Scenes from other methods (submissions), read from a folder and scored as rows of a method.

    DIR/SCENE/scene.json | scene.xml | scene.glb | poses.json
    DIR/SCENE/result.json            optional: {"seconds": 12.5}
    DIR/SCENE/start_0/...            the same files for each initial scene (start), if the method
                                     was given the initial scenes

Objects have the names of the ground truth. Their poses are in the world frame of the ground truth,
or, if a poses.json has "frame": "camera", in the frame of the ground truth's camera.
The files are untrusted: they are read within bounds, and no code in them is run.
"""

from pathlib import Path

import numpy as np
from pydantic import Field

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.importing_scene import ImportedScene, import_file
from neoworld_mjx.io import read_model
from neoworld_mjx.io.names import identifier
from neoworld_mjx.measure import measured
from neoworld_mjx.spec import SceneSpec, Spec, read_scene
from neoworld_mjx.spec.pose import from_matrix, pose
from neoworld_mjx.spec.scene import transformed_scene

from ..rows import log
from .layout_errors import unmatched
from .scene_methods import MethodResult

MESHES = ("scene.glb", "poses.json")
"""Files with meshes, which do not state which objects are fixed. An object is fixed if it is fixed
in the ground truth."""
FILES = ("scene.json", "scene.xml", *MESHES)
"""File names of a submitted scene. If there are several files, the first in this order is read."""
RESULT = "result.json"
FIXED_PREFIX = "held_"
"""Prefix for the name of an object that is fixed in the submission but free in the ground truth."""


class SubmittedResult(Spec):
    """Optional metadata of a submitted scene."""

    seconds: float | None = Field(default=None, ge=0, allow_inf_nan=False)
    """Time that the method took for the scene [s]."""


def submission_name(folder: Path) -> str:
    """Return the name under which a folder's scenes appear as a method."""
    return f"submission:{identifier(folder.resolve().name, 'submission')}"


def submitted_starts(folder: Path, scene: str, starts: int) -> tuple[int, ...]:
    """Return the numbers of the initial scenes for which a folder has results.

    If the scene's folder contains a scene file, the result is only 0. Otherwise it must have a
    folder for each of the requested initial scenes.

    Args:
        folder: folder of the submission.
        scene: name of the scene.
        starts: requested number of initial scenes.

    Raises:
        SpecError: there is no scene file, or the file of an initial scene is missing.
    """
    if not folder.is_dir():
        raise SpecError(f"submission: {folder} is no folder")
    if scene_file(folder / scene) is not None:
        return (0,)
    if not (folder / scene / "start_0").is_dir():
        raise SpecError(
            f"submission: {folder / scene} has none of {', '.join(FILES)}, nor start_0 with one; "
            "--scenes NAME scores only the named scenes"
        )
    for start in range(starts):
        if scene_file(_place(folder, scene, start)) is None:
            raise SpecError(
                f"submission: {folder / scene}/start_{start} has none of {', '.join(FILES)}; "
                "--starts must be the number of submitted starts"
            )
    return tuple(range(starts))


def submitted(folder: Path, start: int, truth: SceneSpec, o: RefineOptions) -> MethodResult:
    """Read and measure the submitted result for an initial scene.

    An object that is free in the ground truth but fixed in the file counts as missed; the fixed
    object gets another name. If the file has no camera, the ground truth's camera is used.

    Args:
        folder: folder of the submission.
        start: number of the initial scene.
        truth: ground truth, as photographed. Its name is the name of the scene's folder.
        o: options of the final check.

    Raises:
        SpecError: a file is broken or exceeds a bound, or the scene has none of the ground truth's
            movable objects.
    """
    place = _place(folder, truth.name, start)
    file = scene_file(place)
    if file is None:
        raise SpecError(f"submission: {place} has none of {', '.join(FILES)}")
    read = read_scene_file(file)
    scene = _before_camera(read, truth)
    scene = _renamed(_with_supports(scene, truth) if file.name in MESHES else scene, truth)
    for note in read.notes:
        log.info(f"{truth.name}: {note}")
    if scene.camera is None:
        scene = scene.model_copy(update={"camera": truth.camera})
    movable = [item.name for item in truth.objects if not item.static]
    if len(unmatched(scene, truth)[0]) == len(movable):
        raise SpecError(
            f"submission: {file} has no object of the scene that is free to move; the movable "
            f"objects of the scene are {', '.join(movable)}"
        )
    result = SubmittedResult()
    if (place / RESULT).exists():
        result = read_model(place / RESULT, SubmittedResult, SpecError, "a result")
    return MethodResult(scene, measured(scene, o), result.seconds, result.seconds)


def _place(folder: Path, scene: str, start: int) -> Path:
    """Return the folder with a start's result: the scene's folder if it contains a scene file."""
    scene_folder = folder / scene
    return scene_folder if scene_file(scene_folder) is not None else scene_folder / f"start_{start}"


def scene_file(folder: Path) -> Path | None:
    """Return the first of FILES that exists in a folder; None if there is none."""
    return next((folder / name for name in FILES if (folder / name).exists()), None)


def read_scene_file(file: Path) -> ImportedScene:
    """Read a scene.json, an MJCF or glTF scene, or a poses.json, with the reader's notes.

    Raises:
        SpecError: the file cannot be read, or contains a single object.
    """
    if file.suffix == ".json" and file.name not in MESHES:
        return ImportedScene(read_scene(file), ())
    imported = import_file(file)
    if not isinstance(imported, ImportedScene):
        raise SpecError(f"submission: {file} holds one object, not a scene on its supports")
    return imported


def _before_camera(read: ImportedScene, truth: SceneSpec) -> SceneSpec:
    """Return a scene in the ground truth's world frame, converted from the frame of its camera."""
    if not read.in_camera or read.camera is None or read.camera.pose is None:
        return read.spec
    if truth.camera is None:
        raise SpecError(f"submission: {truth.name} has no camera, so poses must be in the world")
    camera_pose = np.array(read.camera.pose)
    frame = pose(camera_pose[:3, 3], from_matrix(camera_pose[:3, :3]))
    camera = pose(truth.camera.position(), from_matrix(truth.camera.axes()))
    return transformed_scene(read.spec, camera.then(frame.inverse()))


def _with_supports(scene: SceneSpec, truth: SceneSpec) -> SceneSpec:
    """Fix the objects that are fixed in the ground truth."""
    fixed = {item.name: item for item in truth.objects if item.static}
    objects = (
        item.model_copy(
            update={
                "environment": fixed[item.name].environment,
                "fixed_base": fixed[item.name].fixed_base,
            }
        )
        if item.name in fixed and not item.static
        else item
        for item in scene.objects
    )
    return scene.model_copy(update={"objects": tuple(objects)})


def _renamed(scene: SceneSpec, truth: SceneSpec) -> SceneSpec:
    """Rename objects that are fixed in the scene but free in the ground truth."""
    free = {item.name for item in truth.objects if not item.static}
    names = {
        item.name: identifier(
            FIXED_PREFIX + item.name, "object", {other.name for other in scene.objects}
        )
        for item in scene.objects
        if item.static and item.name in free
    }
    objects = (
        item.model_copy(
            update={
                "name": names.get(item.name, item.name),
                "parent": names.get(item.parent or "", item.parent),
            }
        )
        for item in scene.objects
    )
    return scene.model_copy(update={"objects": tuple(objects)}) if names else scene

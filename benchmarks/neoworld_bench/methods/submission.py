"""Scenes that other methods made, read from a folder and scored as the rows of a method.

    DIR/SCENE/scene.json | scene.xml | scene.usda | scene.usd | scene.usdc | scene.glb | poses.json
    DIR/SCENE/result.json            optional: {"seconds": 12.5}
    DIR/SCENE/start_0/...            the same for each start, where a method begins at starts

Names of objects are those of the ground truth, and their poses are in the ground truth's world, or
with "frame": "camera" in a poses.json in the frame of its camera.
Files are a stranger's: they are read within bounds and nothing in them is run.
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
from neoworld_mjx.spec.scene import moved_whole

from ..rows import log
from .layout_errors import unmatched
from .scene_methods import MethodResult

MESHES = ("scene.glb", "poses.json")
"""Scenes of meshes, which do not say what is a support: objects that the ground truth fixes are."""
FILES = ("scene.json", "scene.xml", "scene.usda", "scene.usd", "scene.usdc", *MESHES)
"""Names of a submitted scene; of several the first counts."""
RESULT = "result.json"
HELD = "held_"
"""Prefix of the name of an object that is fixed although the ground truth's is free."""


class SubmittedResult(Spec):
    """Optional metadata of a submitted scene."""

    seconds: float | None = Field(default=None, ge=0, allow_inf_nan=False)
    """Time to produce the scene."""


def submission_name(folder: Path) -> str:
    """Return the method name of a folder's rows."""
    return f"submission:{identifier(folder.resolve().name, 'submission')}"


def submitted_starts(folder: Path, scene: str, starts: int) -> tuple[int, ...]:
    """Return the numbers of the initial scenes that a folder covers: only 0, or as many as
    requested.

    Raises:
        SpecError: there is no scene, or there are scenes of starts but not of all.
    """
    if not folder.is_dir():
        raise SpecError(f"submission: {folder} is no folder")
    if scene_file(folder / scene) is not None:
        return (0,)
    if not (folder / scene / "start_0").is_dir():
        raise SpecError(
            f"submission: {folder / scene} has none of {', '.join(FILES)}, nor start_0 with one; "
            "--scenes scores only the scenes that it names"
        )
    for start in range(starts):
        if scene_file(_place(folder, scene, start)) is None:
            raise SpecError(
                f"submission: {folder / scene}/start_{start} has none of {', '.join(FILES)}; "
                "--starts says how many there are"
            )
    return tuple(range(starts))


def submitted(folder: Path, start: int, truth: SceneSpec, o: RefineOptions) -> MethodResult:
    """Read and measure what a folder has for a start of a scene.

    An object that the ground truth has free to move and the file fixed is missed, and its like in
    the scene gets another name. Without a camera the scene has the ground truth's.

    Args:
        folder: of the submission.
        start: number of the start.
        truth: the scene's, as photographed; its name is the scene's folder.
        o: options of the final check.

    Raises:
        SpecError: a file is broken or hostile, or holds none of the ground truth's objects.
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
            f"submission: {file} has no object of the scene that is free to move; the scene's are "
            f"{', '.join(movable)}"
        )
    said = SubmittedResult()
    if (place / RESULT).exists():
        said = read_model(place / RESULT, SubmittedResult, SpecError, "a result")
    return MethodResult(scene, measured(scene, o), said.seconds, said.seconds)


def _place(folder: Path, scene: str, start: int) -> Path:
    """Return the folder of a start, which is the scene's where that has a file of its own."""
    own = folder / scene
    return own if scene_file(own) is not None else own / f"start_{start}"


def scene_file(folder: Path) -> Path | None:
    """Return the file of a folder's scene, the first of FILES; None if there is none."""
    return next((folder / name for name in FILES if (folder / name).exists()), None)


def read_scene_file(file: Path) -> ImportedScene:
    """Read a scene.json, an MJCF, USD or glTF scene, or a poses.json, with notes of the reader.

    Raises:
        SpecError: it cannot be read, or holds a single object.
    """
    if file.suffix == ".json" and file.name not in MESHES:
        return ImportedScene(read_scene(file), ())
    imported = import_file(file)
    if not isinstance(imported, ImportedScene):
        raise SpecError(f"submission: {file} holds one object, not a scene on its supports")
    return imported


def _before_camera(read: ImportedScene, truth: SceneSpec) -> SceneSpec:
    """Return a scene in the ground truth's world; poses in a camera's frame are in its camera's."""
    if not read.in_camera or read.camera is None or read.camera.pose is None:
        return read.spec
    if truth.camera is None:
        raise SpecError(f"submission: {truth.name} has no camera, so poses must be in the world")
    given = np.array(read.camera.pose)
    frame = pose(given[:3, 3], from_matrix(given[:3, :3]))
    camera = pose(truth.camera.position(), from_matrix(truth.camera.axes()))
    return moved_whole(read.spec, camera.then(frame.inverse()))


def _with_supports(scene: SceneSpec, truth: SceneSpec) -> SceneSpec:
    """Fix the objects that the ground truth fixes."""
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
    """Rename objects that are fixed here and free in the ground truth."""
    free = {item.name for item in truth.objects if not item.static}
    names = {
        item.name: identifier(HELD + item.name, "object", {other.name for other in scene.objects})
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

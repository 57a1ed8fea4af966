"""Scenes of another method (a submission), read from a folder and scored as rows of a method.

    DIR/SCENE/scene.json | scene.xml | scene.glb | poses.json

Objects have the names of the ground truth. Their poses are in the world frame of the ground truth,
or, if a poses.json has "frame": "camera", in the frame of the ground truth's camera. The files are
untrusted: they are read within bounds, and no code in them is run.
"""

from pathlib import Path

import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.importing import ImportedScene, import_file
from neoworld_mjx.io.names import identifier
from neoworld_mjx.measure import measured
from neoworld_mjx.spec import SceneSpec, read_scene
from neoworld_mjx.spec.pose import from_matrix, pose
from neoworld_mjx.spec.scene import transformed_scene

from ..rows import log
from .scene_methods import MethodResult

MESHES = ("scene.glb", "poses.json")
"""Files with meshes, which do not state which objects are fixed. An object is fixed if it is fixed
in the ground truth."""
FILES = ("scene.json", "scene.xml", *MESHES)
"""File names of a submitted scene. If there are several files, the first in this order is read."""


def submission_name(folder: Path) -> str:
    """Return the name under which a folder's scenes appear as a method."""
    return f"submission:{identifier(folder.resolve().name, 'submission')}"


def submitted(folder: Path, truth: SceneSpec, o: RefineOptions) -> MethodResult:
    """Read and measure the submitted scene.

    If the file has no camera, the ground truth's camera is used.

    Args:
        folder: folder of the submission.
        truth: ground truth, as photographed. Its name is the name of the scene's folder.
        o: options with the bounds of the final check.

    Raises:
        SpecError: there is no file, it cannot be read, an object that is free in the ground truth
            is fixed, or no object of the ground truth is free to move.
    """
    place = folder / truth.name
    file = next((place / name for name in FILES if (place / name).exists()), None)
    if file is None:
        raise SpecError(
            f"submission: {place} has none of {', '.join(FILES)}; --scenes NAME scores only the "
            "named scenes"
        )
    own = file.name == "scene.json"
    read = ImportedScene(read_scene(file), ()) if own else import_file(file)
    if not isinstance(read, ImportedScene):
        raise SpecError(f"submission: {file} holds one object, not a scene on its supports")
    for note in read.notes:
        log.info(f"{truth.name}: {note}")
    scene = _before_camera(read, truth)
    if file.name in MESHES:
        scene = _with_supports(scene, truth)
    if scene.camera is None:
        scene = scene.model_copy(update={"camera": truth.camera})
    free = {item.name for item in truth.objects if not item.static}
    fixed = [item.name for item in scene.objects if item.static and item.name in free]
    if fixed:
        raise SpecError(
            f"submission: {file} fixes {', '.join(fixed)}, free to move in the ground truth"
        )
    if free.isdisjoint(item.name for item in scene.objects):
        raise SpecError(
            f"submission: {file} has no object of the scene that is free to move; the movable "
            f"objects of the scene are {', '.join(sorted(free))}"
        )
    return MethodResult(scene, measured(scene, o), None, None)


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

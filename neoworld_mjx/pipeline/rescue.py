"""Rescue: make posed meshes of another method stand without penetration, and export them.

A rescue is a run whose Steps 1 to 3 are read from a file: the meshes take the place of programs,
and their poses that of the parse. Steps 4 and 5, files and report are those of every run.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..config import Config
from ..errors import EvidenceError, PhotoError, RunError
from ..evidence.evidence import Evidence, PhotoPixels
from ..evidence.evidence_file import OWN_CAMERA, StatedEvidence, evidence_of, undistorted
from ..evidence.file_camera import FileCamera
from ..evidence.known_camera import KnownCamera
from ..evidence.known_objects import KnownObjects
from ..export.importing import ImportedScene, import_file
from ..io import bounded_by
from ..parse.photo import load_photo
from ..render import to_png
from ..run_folder import Result, RunFolder
from ..spec import Camera
from ..spec.pose import from_yaw, pose, rotate
from ..spec.scene import scene_in_frame, transformed_scene
from .given_evidence import RunEvidence, keep_evidence
from .mesh_tree import MeshTree, doubt_solids, doubt_unit, mesh_tree, scaled_scene
from .reconstruction import finish, run_steps
from .step_context import GIVEN, PHOTO, SPEC, TREE, object_file, write_files

CAMERA_HELP = (
    'give it by --camera FILE.json, as {"fx": 600, "fy": 600, "cx": 320, "cy": 240, '
    '"pose": [[4x4]]}, '
    "where pose transforms the camera's frame (OpenCV) to the scene's world frame (Z up); or give "
    "it in the scene's file (docs/how-to/rescue-meshes.md)"
)


def rescue_file(
    file: Path,
    out: Path,
    config: Config | None = None,
    *,
    photo: Path | None = None,
    evidence: StatedEvidence | None = None,
    scale: float | None = None,
) -> Result:
    """Rescue a glTF scene or a poses.json into a run folder.

    Args:
        file: the scene; see `export.importing_scene`.
        out: run folder, new or empty.
        config: options.
        photo: the photograph of the scene, with which its objects are aligned.
        evidence: evidence about the photograph, and known sizes and places of objects. Without a
            camera, that of the scene's file is used. If `base` is stated, the result is in the
            world of the scene's file, which is the base frame; otherwise, the camera is above the
            origin.
        scale: factor of all lengths in the scene's file, such as 0.01 for centimeters; if None, the
            file is in meters, and unusual sizes are refused.

    Raises:
        EvidenceError: a file cannot be read, or contradicts the photograph.
        SpecError: a file cannot be read, no object is free to move, or the file is in doubt
            (`mesh_tree`).
        PhotoError: as for `photo_evidence`.
        RunError: the folder is not empty, or cannot be written.
    """
    c = config or Config()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RunError(f"{out} is not empty; name a new folder")
    if evidence is not None and evidence.of_photo and photo is None:
        raise PhotoError("this evidence is about a photograph: give it by --photo")
    if evidence is not None and evidence.objects:
        raise EvidenceError("objects: the objects are those of the scene's file; edit it")
    with bounded_by(c.files):
        imported = import_file(file)
        if not isinstance(imported, ImportedScene):
            raise RunError(f"{file} contains one object; rescue needs a scene")
        if scale is None:
            doubt_unit(imported.spec)
        else:
            imported = scaled_scene(imported, scale)
        doubt_solids(imported.spec)
        given, rgb = evidence or StatedEvidence(), None
        known = Evidence(objects=KnownObjects(sizes=given.sizes, keep=given.keep))
        if photo is not None:
            rgb, known = photo_evidence(photo, given, imported.camera, c.parse.max_side_px)
        meshes, c = posed_tree(imported, known.camera), as_given(c, photo=rgb is not None)
        known.objects.check_names(meshes.tree)
        notes = [*imported.notes, *meshes.notes]
        if known.camera is not None and known.camera.source == OWN_CAMERA:
            notes.append(f"the camera of the photograph is taken from {file.name}")
        if known.camera is not None and given.base is None:
            known = replace(known, camera=replace(known.camera, base=None, heading=0.0))
        with RunFolder(out, c) as run:
            run.record("photo", name=file.name if photo is None else photo.name)
            keep_evidence(run, RunEvidence(known))
            _write_given(run, file, meshes, rgb, known.camera)
            for note in notes:
                run.note("parse", note, f"read from {file.name}")
            run_steps(run, c, None, first="compose")
            return finish(run, None)


def photo_evidence(
    photo: Path, given: StatedEvidence, own: FileCamera | None, max_side_px: int = 1568
) -> tuple[PhotoPixels, Evidence]:
    """Read the photograph of a scene, undistorted, and what is known about it.

    Args:
        photo: the picture.
        given: evidence that the user gives; its camera takes precedence over `own`.
        own: camera in the scene's file, if any.
        max_side_px: longest side to which the picture is reduced [px].

    Raises:
        EvidenceError: the evidence does not match the photograph.
        PhotoError: the file is not a picture, or the camera is incomplete.
    """
    read = load_photo(photo, max_side_px)
    known = evidence_of(given, photo.name, read.rgb, read.original_size, own)
    camera = known.camera
    if camera is None:
        raise PhotoError(f"{photo}: the scene's file states no camera: {CAMERA_HELP}")
    if camera.base is None or camera.focal is None:
        missing = "pose" if camera.base is None else "field of view (fovy, or fx, fy, cx and cy)"
        raise PhotoError(f"the camera of the photograph has no {missing}: {CAMERA_HELP}")
    rgb = undistorted(Evidence(photo=read.rgb, lens=known.lens)).photo
    assert rgb is not None
    # The scene's height follows from its main support.
    return rgb, replace(known, camera=replace(camera, height=None))


def posed_tree(imported: ImportedScene, known: KnownCamera | None = None) -> MeshTree:
    """Return the tree of a scene; if its camera's place is known, it is above the origin."""
    if known is None or known.base is None:
        return mesh_tree(imported.spec)
    back = from_yaw(-known.heading)
    x, y, z = rotate(back, np.array(known.base)).tolist()
    width, height_px = known.size
    camera = known.camera(Camera(width=width, height_px=height_px, fovy=1, height=z, pitch=0))
    return mesh_tree(transformed_scene(imported.spec, pose((-x, -y, 0.0), back)), camera)


def as_given(config: Config, *, photo: bool) -> Config:
    """Return options with which Steps 4 and 5 keep what is given: colors, and the camera.

    Args:
        config: the options.
        photo: True if there is a photograph, with which the scene can be aligned.
    """
    align = {"camera": False, "enabled": config.compose.align.enabled and photo}
    compose = {"looks": False, "align": config.compose.align.model_copy(update=align)}
    return config.model_copy(update={"compose": config.compose.model_copy(update=compose)})


def _write_given(
    run: RunFolder,
    file: Path,
    meshes: MeshTree,
    rgb: PhotoPixels | None,
    known: KnownCamera | None,
) -> None:
    """Write what Steps 1 to 3 of other runs write: the tree, and the objects."""
    given, frame = meshes.given, None
    if given.camera is not None and known is not None:
        frame = known.base_frame(given.camera)
    if frame is not None:
        given = scene_in_frame(given, frame)
    with run.step("parse", {"file": file}) as out:
        assert out is not None  # The folder is new.
        write_files(out, {TREE: meshes.tree.to_json(), GIVEN: given.to_json()})
        if rgb is not None:
            write_files(out, {PHOTO: to_png(rgb)})
        for name, spec in meshes.objects.items():
            write_files(out, {object_file(name, SPEC): spec.to_json()})

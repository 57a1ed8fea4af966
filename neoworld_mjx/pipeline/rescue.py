"""Rescue: make posed meshes of another method stand without penetration, and export them.

A rescue is a run whose Steps 1 to 3 are read from a file: the meshes take the place of programs,
and their poses that of the parse. Steps 4 and 5, files and report are those of every run.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ..config import Config
from ..errors import EvidenceError, PhotoError, RunError
from ..evidence.evidence import Evidence
from ..evidence.evidence_file import StatedEvidence, evidence_of, stated_camera, undistorted
from ..evidence.file_camera import FileCamera
from ..evidence.known_camera import KnownCamera
from ..evidence.known_objects import KnownObjects
from ..export.importing import ImportedScene, import_file
from ..export.read_mesh_scene import CAMERA_HELP, Viewpoint, viewpoint
from ..io import bounded_by
from ..parse.photo import load_photo
from ..render import to_png
from ..run_folder import Result, RunFolder
from ..spec.scene import scene_in_frame, transformed_scene
from .given_evidence import RunEvidence, keep_evidence
from .input_doubts import doubt_solids, doubt_unit, scaled_scene
from .mesh_tree import MeshTree, mesh_tree
from .reconstruction import finish, run_steps
from .step_context import GIVEN, PHOTO, SPEC, TREE, object_file, write_files


@dataclass(frozen=True)
class Photographed:
    """The photograph of a given scene."""

    rgb: UInt8[np.ndarray, "row column 3"] = field(repr=False)
    """Colors (sRGB), undistorted to the image of the camera."""
    view: Viewpoint


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
            (`input_doubts`).
        PhotoError: as for `photographed`.
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
        picture, camera = None, None
        given = evidence or StatedEvidence()
        known = Evidence(objects=KnownObjects(sizes=given.sizes, keep=given.keep))
        if photo is not None:
            camera, _ = stated_camera(given, photo.name)
            picture = photographed(photo, imported.camera, camera, c.parse.max_side_px)
            known = _known(given, photo, picture, c.parse.max_side_px)
        meshes, c = posed_tree(imported, picture), as_given(c, photo=picture is not None)
        known.objects.check_names(meshes.tree)
        notes = [*imported.notes, *meshes.notes]
        if picture is not None and camera is None:
            notes.append(f"the camera of the photograph is taken from {file.name}")
        with RunFolder(out, c) as run:
            run.record("photo", name=file.name if photo is None else photo.name)
            keep_evidence(run, RunEvidence(known))
            _write_given(run, file, meshes, picture, known.camera)
            for note in notes:
                run.note("parse", note, f"read from {file.name}")
            run_steps(run, c, None, first="compose")
            return finish(run, None)


def photographed(
    file: Path, stated: FileCamera | None, camera: FileCamera | None, max_side_px: int = 1568
) -> Photographed:
    """Read the photograph of a scene.

    Args:
        file: the picture.
        stated: camera in the scene's file, if any.
        camera: camera that the user gives; its values take precedence over those of `stated`.
        max_side_px: longest side to which the picture is reduced [px].

    Raises:
        EvidenceError: the camera does not match the photograph.
        PhotoError: the file is not a picture, or the camera is incomplete.
    """
    if stated is None and camera is None:
        raise PhotoError(f"{file}: the scene's file states no camera: {CAMERA_HELP}")
    full = (camera or FileCamera()).completed_by(stated)
    read = load_photo(file, max_side_px)
    view = viewpoint(full, *read.original_size)
    rgb = undistorted(Evidence(photo=read.rgb, lens=view.lens)).photo
    assert rgb is not None
    return Photographed(rgb, view)


def _known(given: StatedEvidence, photo: Path, picture: Photographed, max_side: int) -> Evidence:
    """Return the evidence about a photograph whose camera is `picture.view.camera`."""
    taken, camera = load_photo(photo, max_side), picture.view.camera
    known = evidence_of(given, photo.name, taken.rgb, taken.original_size)
    size = (camera.width, camera.height_px)
    source = "the scene's file" if known.camera is None else known.camera.source
    exact = KnownCamera(
        *(size, camera.focal),
        principal=camera.principal,
        pitch=camera.pitch,
        roll=camera.roll,
        source=source,
    )
    if given.base is not None and known.camera is not None:
        exact = replace(exact, base=known.camera.base, heading=known.camera.heading)
    return replace(known, camera=exact, lens=picture.view.lens)


def posed_tree(imported: ImportedScene, photo: Photographed | None = None) -> MeshTree:
    """Return the tree of a scene; with a photograph, its camera is above the origin."""
    if photo is None:
        return mesh_tree(imported.spec)
    given = transformed_scene(imported.spec, photo.view.scene_transform)
    return mesh_tree(given, photo.view.camera)


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
    photo: Photographed | None,
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
        if photo is not None:
            write_files(out, {PHOTO: to_png(photo.rgb)})
        for name, spec in meshes.objects.items():
            write_files(out, {object_file(name, SPEC): spec.to_json()})

"""Rescue: make posed meshes of another method stand without penetration, and export them.

A rescue is a run whose Steps 1 to 3 are read from a file: the meshes take the place of programs,
and their poses that of the parse. Steps 4 and 5, files and report are those of every run.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ..config import Config
from ..engines import EngineChoice
from ..errors import PhotoError, RunError
from ..export.importing import ImportedScene, import_file
from ..export.read_mesh_scene import CAMERA_HELP, FileCamera, Viewpoint, read_camera, viewpoint
from ..io import bounded_by
from ..measure import object_moves
from ..parse.photo import load_photo
from ..physics.engine import Engine
from ..render import to_png
from ..run_folder import Result, RunFolder
from ..spec import SceneObject, SceneSpec
from ..spec.scene import transformed_scene
from .input_doubts import doubt_solids, doubt_unit, scaled_scene
from .mesh_tree import MeshTree, mesh_tree
from .place import Evidence, LayoutEstimate, RefinedPlacement, place, refine_placed
from .reconstruction import finish, run_steps
from .step_context import GIVEN, PHOTO, TREE


@dataclass(frozen=True)
class Photographed:
    """The photograph of a given scene."""

    rgb: UInt8[np.ndarray, "row column 3"] = field(repr=False)
    """Colors (sRGB), cropped to the image of the camera."""
    view: Viewpoint


@dataclass(frozen=True)
class Rescued:
    """A rescued scene, and how it came about."""

    given: SceneSpec
    """The objects at their given poses, with fixed supports. With a photograph, the whole scene is
    moved so that its camera is above the origin and looks along +x."""
    placed: LayoutEstimate
    refined: RefinedPlacement
    notes: tuple[str, ...]

    @property
    def scene(self) -> SceneSpec:
        """The rescued scene."""
        return self.refined.scene

    @property
    def passed(self) -> bool:
        """True if the scene passes the final check."""
        return self.refined.refined.passed

    @property
    def moves_m(self) -> dict[str, float]:
        """Distance of each free object from its given position [m]."""
        moves = object_moves(self.given, self.scene)
        return {item.name: moves[item.name].distance_m for item in _free(self.scene)}


def rescue(
    given: SceneSpec | ImportedScene,
    config: Config | None = None,
    *,
    engine: Engine | EngineChoice | None = None,
    photo: Photographed | None = None,
) -> Rescued:
    """Put the objects of a scene onto their supports, align them, and refine the layout.

    Shapes are not corrected. With a photograph, positions, headings and sizes are aligned with its
    contours at the given camera. Otherwise only contacts and the search change the given poses.

    Args:
        given: objects at their poses without parents, as read by `import_file`.
        config: options, of which those of composition, alignment and search are used.
        engine: physics engine, or its name; by default, the engine that the options name.
        photo: the photograph and its camera, from `photographed`.

    Raises:
        SpecError: no object is free to move, or the scene already states parents.
    """
    imported = given if isinstance(given, ImportedScene) else ImportedScene(given, ())
    c, meshes = _config(config or Config(), photo), _meshes(imported, photo)
    evidence = Evidence(None if photo is None else photo.rgb, boxes=False)
    placed = place(meshes.tree, meshes.objects, evidence, c.compose, name=imported.spec.name)
    refined = refine_placed(
        placed.scene,
        c.refine,
        seed=c.seed,
        engine=engine,
        photo=evidence.photo,
        again=c.compose.align,
    )
    notes = (*imported.notes, *meshes.notes, *placed.composed.notes, *placed.notes)
    return Rescued(meshes.given, placed, refined, notes)


def rescue_file(
    file: Path,
    out: Path,
    config: Config | None = None,
    *,
    photo: Path | None = None,
    camera: Path | None = None,
    scale: float | None = None,
) -> Result:
    """Rescue a glTF scene or a poses.json into a run folder.

    Args:
        file: the scene; see `export.importing_scene`.
        out: run folder, new or empty.
        config: options.
        photo: the photograph of the scene, with which its objects are aligned.
        camera: camera.json of the photograph; by default, the camera in the scene's file.
        scale: factor of all lengths in the scene's file, such as 0.01 for centimeters; if None, the
            file is in meters, and unusual sizes are refused.

    Raises:
        SpecError: a file cannot be read, no object is free to move, or the file is in doubt
            (`input_doubts`).
        PhotoError: as for `photographed`.
        RunError: the folder is not empty, or cannot be written.
    """
    c = config or Config()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RunError(f"{out} is not empty; name a new folder")
    if camera is not None and photo is None:
        raise PhotoError("--camera is the camera of a photograph: give it by --photo")
    with bounded_by(c.files):
        imported = import_file(file)
        if not isinstance(imported, ImportedScene):
            raise RunError(f"{file} contains one object; rescue needs a scene")
        if scale is None:
            doubt_unit(imported.spec)
        else:
            imported = scaled_scene(imported, scale)
        doubt_solids(imported.spec)
        picture = None
        if photo is not None:
            stated = None if camera is None else read_camera(camera)
            picture = photographed(photo, imported.camera, stated, c.parse.max_side_px)
        meshes, c = _meshes(imported, picture), _config(c, picture)
        notes = [*imported.notes, *meshes.notes]
        if picture is not None and camera is None:
            notes.append(f"the camera of the photograph is taken from {file.name}")
        with RunFolder(out, c) as run:
            run.record("photo", name=file.name if photo is None else photo.name)
            _write_given(run, file, meshes, picture)
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
        PhotoError: the file is not a picture, or the camera is incomplete or does not match the
            photograph.
    """
    if stated is None and camera is None:
        raise PhotoError(f"{file}: the scene's file states no camera: {CAMERA_HELP}")
    full = (camera or FileCamera()).completed_by(stated)
    read = load_photo(file, max_side_px)
    width, height = read.original_size
    view = viewpoint(full, width, height)
    scale = read.scale
    left, top = round(scale * view.left), round(scale * view.top)
    right = left + round(scale * view.camera.width)
    bottom = top + round(scale * view.camera.height_px)
    return Photographed(read.rgb[top:bottom, left:right], view)


def _meshes(imported: ImportedScene, photo: Photographed | None) -> MeshTree:
    if photo is None:
        return mesh_tree(imported.spec)
    given = transformed_scene(imported.spec, photo.view.scene_transform)
    return mesh_tree(given, photo.view.camera)


def _config(config: Config, photo: Photographed | None) -> Config:
    """Return options with which Steps 4 and 5 keep what is given: colors, and the camera."""
    align = {"camera": False, "enabled": config.compose.align.enabled and photo is not None}
    compose = {"looks": False, "align": config.compose.align.model_copy(update=align)}
    return config.model_copy(update={"compose": config.compose.model_copy(update=compose)})


def _write_given(run: RunFolder, file: Path, meshes: MeshTree, photo: Photographed | None) -> None:
    """Write what Steps 1 to 3 of other runs write: the tree, and the objects."""
    with run.step("parse", {"file": file}) as out:
        assert out is not None  # The folder is new.
        (out / TREE).write_text(meshes.tree.to_json(), encoding="utf-8")
        (out / GIVEN).write_text(meshes.given.to_json(), encoding="utf-8")
        if photo is not None:
            (out / PHOTO).write_bytes(to_png(photo.rgb))
        for name, spec in meshes.objects.items():
            folder = out / "objects" / name
            folder.mkdir(parents=True)
            (folder / "spec.json").write_text(spec.to_json(), encoding="utf-8")


def _free(scene: SceneSpec) -> list[SceneObject]:
    return [item for item in scene.objects if not item.static]

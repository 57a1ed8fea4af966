"""Rescue: make the posed meshes of another method stand, free of penetration, and export them.

A rescue is a run that begins with Step 4: its folder has the same files, search and report as that
of a photograph, without objects' programs and their tests.
"""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ..align.align import align
from ..align.outline_error import outline_errors
from ..align.outline_picture import outline_picture
from ..compose.mesh_supports import with_supports
from ..compose.on_supports import in_contact
from ..config import AlignOptions, ComposeOptions, Config, RefineOptions
from ..engines import EngineChoice
from ..errors import PhotoError, RunError
from ..export.file_camera import WHERE, FileCamera, Viewpoint, read_camera, viewpoint
from ..export.importing_scene import ImportedScene, import_file
from ..io import bounded_by
from ..io.files import write_output
from ..measure import SceneMeasure, measured, object_moves, passes
from ..parse.photo import load_photo
from ..physics.engine import Engine
from ..refinement.scene_refinement import refine
from ..render import to_png
from ..run_folder import RunFolder
from ..spec import SceneSpec, bounds, read_scene
from ..spec.pose import pose
from ..spec.scene import moved_whole
from .reconstruction import finish
from .scene_pictures import Pictures
from .scene_steps import aligned, export_files, refine_layout
from .step_context import COMPOSED, SCENE, StepContext

REPORT = "rescue.json"
GIVEN = "compose/given.json"
GIVEN_PICTURE = "pictures/given.png"
OUTLINE_PICTURE = "pictures/rescued.png"
PHOTO = "photo.png"


@dataclass(frozen=True)
class Photographed:
    """The photograph of a given scene."""

    rgb: UInt8[np.ndarray, "row column 3"] = field(repr=False)
    """sRGB, cropped to the image of the camera."""
    view: Viewpoint


@dataclass(frozen=True)
class Rescued:
    """A scene of another method that was made to stand."""

    scene: SceneSpec
    passed: bool
    """True if it passes the final check."""
    before: SceneMeasure
    """Final check of the objects as they were given, on the supports that were found."""
    moves_m: dict[str, float]
    """Distance of each free object from where it was given."""
    turns_deg: dict[str, float]
    """Angle of each free object from how it was given."""
    outlines_px: dict[str, dict[str, float | None]]
    """Median distance of each object's outline from the photograph's, as given and rescued, in
    pixels of an image 640 px wide (`outline_errors`); empty without a photograph."""
    notes: tuple[str, ...]
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON."""
        return {
            "passed": self.passed,
            "seconds": self.seconds,
            "depth_before_m": self.before.max_depth_m,
            "drift_before_m": min(self.before.max_drift_m, 1e6),
            "moves_m": self.moves_m,
            "turns_deg": self.turns_deg,
            "outlines_px": self.outlines_px,
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class GivenScene:
    """A given scene on its supports, before the search."""

    given: SceneSpec
    """The objects at their given poses, before the camera if there is one."""
    composed: SceneSpec
    notes: tuple[str, ...]


def rescue(
    given: SceneSpec | ImportedScene,
    options: RefineOptions | None = None,
    *,
    seed: int = 0,
    engine: Engine | EngineChoice | None = None,
    photo: Photographed | None = None,
    compose: ComposeOptions | None = None,
) -> Rescued:
    """Put the objects of a scene upright on their supports, settle them, and search if need be.

    Shapes are not corrected. Without a photograph neither are sizes and places, but for what the
    search needs; with one, places, headings and sizes are aligned with its contours first.

    Args:
        given: objects at their poses without parents, as `import_file` reads them.
        options: of the search and the final check.
        seed: of the search.
        engine: physics engine or its name; default: the engine that the options name.
        photo: the photograph and its camera, from `photographed`.
        compose: options of contact and alignment.

    Raises:
        SpecError: nothing is free to move, or the scene has parents already.
    """
    began, o, c = time.perf_counter(), options or RefineOptions(), compose or ComposeOptions()
    read = given if isinstance(given, ImportedScene) else ImportedScene(given, ())
    start = _supported(read, photo)
    composed, notes = start.composed, start.notes
    if photo is not None and c.align.enabled:
        composed, moved = in_contact(align(composed, photo.rgb, _layout_alone(c)).scene, c)
        notes = (*notes, *moved)
    refined = refine(composed, o, seed=seed, engine=engine)
    notes = (*notes, *refined.fallbacks)
    seconds = time.perf_counter() - began
    return _rescued(start, refined.scene, o, photo, notes, seconds, refined.measure)


def photographed(
    file: Path, stated: FileCamera | None, camera: FileCamera | None, max_side_px: int = 1568
) -> Photographed:
    """Read the photograph of a scene.

    Args:
        file: the picture.
        stated: camera of the scene's file, if any.
        camera: camera that the user gives; it counts before that of the file.
        max_side_px: longest side of the picture.

    Raises:
        PhotoError: the file is no picture, or the camera is incomplete or not of this photograph.
    """
    if stated is None and camera is None:
        raise PhotoError(f"{file}: the scene's file states no camera: {WHERE}")
    full = (camera or FileCamera()).completed_by(stated)
    read = load_photo(file, max_side_px)
    width, height = read.original_size
    view = viewpoint(full, width, height)
    scale = read.scale
    left, top = round(scale * view.left), round(scale * view.top)
    right = left + round(scale * view.camera.width)
    bottom = top + round(scale * view.camera.height_px)
    return Photographed(read.rgb[top:bottom, left:right], view)


def rescue_file(
    file: Path,
    out: Path,
    config: Config | None = None,
    *,
    photo: Path | None = None,
    camera: Path | None = None,
) -> Rescued:
    """Rescue a glTF scene or a poses.json into a run folder, with report.html and rescue.json.

    Args:
        file: the scene; see `export.read_mesh_scene`.
        out: folder, new or empty.
        config: options.
        photo: the photograph of the scene: for the alignment and as evidence in the report.
        camera: camera.json of the photograph; by default the camera of the scene's file.

    Raises:
        SpecError: a file cannot be read, or nothing in it is free to move.
        PhotoError: as for `photographed`.
        RunError: the folder is not empty, or cannot be written.
    """
    c = config or Config()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RunError(f"{out} is not empty; name a new folder")
    if camera is not None and photo is None:
        raise PhotoError("--camera is the camera of a photograph: give it by --photo")
    with bounded_by(c.files):
        read = import_file(file)
        if not isinstance(read, ImportedScene):
            raise RunError(f"{file} holds one object; rescue needs a scene")
        picture = None
        if photo is not None:
            own = None if camera is None else read_camera(camera)
            picture = photographed(photo, read.camera, own, c.parse.max_side_px)
        start = _supported(read, picture)
        with RunFolder(out, c) as run:
            run.record("photo", name=file.name if photo is None else photo.name)
            with Pictures(run, c.render) as pictures:
                context = StepContext(run, c, None, None, pictures)
                _compose(context, file, start, picture)
                refine_layout(context)
                export_files(context)
            scene = read_scene(run.path / SCENE)
            fallbacks = (f"{e['what']}: {e['why']}" for e in run.data["fallbacks"])
            notes = (*start.notes, *fallbacks)
            seconds = sum(run.seconds().values())
            rescued = _rescued(start, scene, c.refine, picture, notes, seconds)
            if picture is not None:
                outlines = outline_picture(picture.rgb, start.given, scene)
                write_output(out / OUTLINE_PICTURE, to_png(outlines), RunError)
            write_output(out / REPORT, json.dumps(rescued.to_json(), indent=1) + "\n", RunError)
            finish(run, None)
    return rescued


def _supported(read: ImportedScene, photo: Photographed | None) -> GivenScene:
    """Put the objects of a scene onto supports, before the camera of the photograph."""
    given = read.spec
    if photo is not None:
        given = moved_whole(given, photo.view.placed)
    supported = with_supports(given)
    composed, camera = supported.scene, None
    if photo is not None:
        # The main support's top is at z = 0, as in scenes of photographs.
        down = pose((0.0, 0.0, -_main_top(composed)))
        height = photo.view.camera.height + float(down.pos[2])
        camera = photo.view.camera.model_copy(update={"height": height})
        given, composed = (
            moved_whole(scene, down).model_copy(update={"camera": camera})
            for scene in (given, composed)
        )
    return GivenScene(given, composed, (*read.notes, *supported.notes))


def _main_top(scene: SceneSpec) -> float:
    """Return the height of the top of the support that carries most objects [m]."""
    carried = [item.parent for item in scene.objects]
    supports = [item for item in scene.objects if item.parent is None]
    main = max(supports, key=lambda item: carried.count(item.name))
    return main.z + float(bounds(main.spec, main.joint_state, main.base_tilt)[1][2])


def _layout_alone(options: ComposeOptions) -> AlignOptions:
    """Return the options of an alignment that keeps the camera, which is given."""
    return options.align.model_copy(update={"camera": False})


def _compose(
    context: StepContext, file: Path, start: GivenScene, photo: Photographed | None
) -> None:
    """Write the given and the composed scene of a rescue, as the step `compose`."""
    run, c = context.run, context.config
    inputs: Mapping[str, object] = {"file": file, "options": c.compose}
    with run.step("compose", inputs) as out:
        assert out is not None  # The folder is new.
        (out / "compose").mkdir()
        composed = start.composed
        if photo is not None:
            (out / PHOTO).write_bytes(to_png(photo.rgb))
            if c.compose.align.enabled:
                composed = aligned(run, composed, photo.rgb, _layout_alone(c.compose), out)
                composed, moved = in_contact(composed, c.compose)
                for note in moved:
                    name, _, change = note.partition(": ")
                    run.note("compose", name, change)
        (out / GIVEN).write_text(start.given.to_json(), encoding="utf-8")
        (out / COMPOSED).write_text(composed.to_json(), encoding="utf-8")
        for note in start.notes:
            run.note("compose", note, f"read from {file.name}")
    if photo is not None:
        context.pictures.begin("compose/given", run.path / GIVEN, GIVEN_PICTURE)
    context.pictures.begin("compose/picture", run.path / COMPOSED, "pictures/before.png")


def _rescued(
    start: GivenScene,
    scene: SceneSpec,
    o: RefineOptions,
    photo: Photographed | None,
    notes: tuple[str, ...],
    seconds: float,
    measure: SceneMeasure | None = None,
) -> Rescued:
    """Compare a rescued scene with the given one."""
    fixed = {item.name for item in start.composed.objects if item.environment}
    on_supports = start.given.model_copy(
        update={
            "objects": tuple(
                item.model_copy(update={"environment": item.name in fixed or item.environment})
                for item in start.given.objects
            )
        }
    )
    free = [item.name for item in scene.objects if not item.static]
    moves = object_moves(on_supports, scene)
    outlines: dict[str, dict[str, float | None]] = {}
    if photo is not None:
        given, ended = (outline_errors(s, photo.rgb) for s in (on_supports, scene))
        outlines = {name: {"given": given.get(name), "rescued": ended.get(name)} for name in free}
    return Rescued(
        scene,
        passes(measure or measured(scene, o), o),
        measured(on_supports, o),
        {name: moves[name].distance_m for name in free},
        {name: moves[name].turn_deg for name in free},
        outlines,
        notes,
        seconds,
    )

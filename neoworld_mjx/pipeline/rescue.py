"""Rescue: make posed meshes of another method stand without penetration, and export them.

A rescue is a run that begins with Step 4. It has the same search, files and report as the run of a
photograph, but no programs of objects and no tests of these programs.
"""

import json
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ..align.align import align
from ..align.alignment import Alignment
from ..align.outline_error import outline_errors
from ..align.outline_picture import outline_picture
from ..compose.mesh_supports import FoundSupports, find_supports, with_supports
from ..compose.on_supports import in_contact
from ..config import ComposeOptions, Config, RefineOptions
from ..engines import EngineChoice
from ..errors import PhotoError, RunError
from ..export.file_camera import CAMERA_HELP, FileCamera, Viewpoint, read_camera, viewpoint
from ..export.importing_scene import ImportedScene, import_file
from ..io import bounded_by, read_object
from ..io.files import write_output
from ..measure import SceneMeasure, measured, object_moves, passes
from ..parse.photo import load_photo
from ..physics.engine import Engine
from ..refinement.scene_refinement import refine
from ..render import to_png
from ..run_folder import RunFolder
from ..spec import SceneSpec, bounds, read_scene
from ..spec.pose import pose
from ..spec.scene import transformed_scene
from .compose_step import write_alignment
from .reconstruction import finish
from .scene_pictures import Pictures
from .scene_steps import export_files, refine_layout
from .step_context import COMPOSED, RESULT, SCENE, StepContext

REPORT = "rescue.json"
GIVEN_SCENE = "compose/given.json"
GIVEN_PICTURE = "pictures/given.png"
OUTLINE_PICTURE = "pictures/rescued.png"
PHOTO = "photo.png"
RESTS_M, RESTS_DEG = 2e-3, 1.0
"""Largest motion [m] and tilt [deg] in the final check at which an object rests at its given
pose."""


@dataclass(frozen=True)
class Photographed:
    """The photograph of a given scene."""

    rgb: UInt8[np.ndarray, "row column 3"] = field(repr=False)
    """Colors (sRGB), cropped to the image of the camera."""
    view: Viewpoint


@dataclass(frozen=True)
class Rescued:
    """A rescued scene, and its differences from the given scene."""

    scene: SceneSpec
    passed: bool
    """True if the scene passes the final check."""
    before: SceneMeasure
    """Final check of the objects at their given poses, with the supports that were found."""
    moves_m: dict[str, float]
    """Distance of each free object from its given position [m]."""
    turns_deg: dict[str, float]
    """Angle between the rotation of each free object and its given rotation [deg]."""
    sizes: dict[str, float]
    """Ratio of the size of each free object to its given size."""
    outlines_px: dict[str, dict[str, float | None]]
    """Median distance between each object's outline and the photograph's, as given and as rescued,
    in pixels of an image 640 px wide (`outline_errors`). It is empty without a photograph."""
    notes: tuple[str, ...]
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON data."""
        return {
            "passed": self.passed,
            "seconds": self.seconds,
            "depth_before_m": self.before.max_depth_m,
            "drift_before_m": min(self.before.max_drift_m, 1e6),
            "moves_m": self.moves_m,
            "turns_deg": self.turns_deg,
            "sizes": self.sizes,
            "outlines_px": self.outlines_px,
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class PreparedScene:
    """A given scene, and the composed scene before the search."""

    given: SceneSpec
    """The objects at their given poses, with fixed supports. With a photograph, the whole scene is
    moved so that its camera is above the origin and looks along +x."""
    before: SceneMeasure
    """Final check of `given`."""
    supported: SceneSpec
    """The objects on their supports."""
    alignment: Alignment | None
    """Alignment of `supported` with the photograph; None if there is no photograph or if the
    alignment is not applied."""
    composed: SceneSpec
    """The scene from which the search starts."""
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
    """Put the objects of a scene upright on their supports, and refine the layout if necessary.

    Shapes are not corrected. Objects that rest at their given poses are put on their supports
    without a change of pose. With a photograph, positions, headings and sizes are aligned with the
    contours of the photograph, if this does not increase the median outline error. Otherwise, only
    the search changes positions and headings, and sizes are corrected by the given heights
    (`fit_sizes`), if `compose.mesh_sizes` is set.

    Args:
        given: objects at their poses without parents, as read by `import_file`.
        options: options of the search and the final check.
        seed: seed of the search.
        engine: physics engine, or its name; by default, the engine that the options name.
        photo: the photograph and its camera, from `photographed`.
        compose: options of contact and alignment.

    Raises:
        SpecError: no object is free to move, or the scene already states parents.
    """
    start_time, o, c = time.perf_counter(), options or RefineOptions(), compose or ComposeOptions()
    imported = given if isinstance(given, ImportedScene) else ImportedScene(given, ())
    prepared = _prepare(imported, photo, o, c)
    refined = refine(prepared.composed, o, seed=seed, engine=engine)
    notes = (*prepared.notes, *refined.fallbacks)
    passed, seconds = passes(refined.measure, o), time.perf_counter() - start_time
    return _result(prepared, refined.scene, passed, photo, notes, seconds)


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
        file: the scene; see `export.importing_scene`.
        out: run folder, new or empty.
        config: options.
        photo: the photograph of the scene, for the alignment and as evidence in the report.
        camera: camera.json of the photograph; by default, the camera in the scene's file.

    Raises:
        SpecError: a file cannot be read, or no object is free to move.
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
        picture = None
        if photo is not None:
            stated = None if camera is None else read_camera(camera)
            picture = photographed(photo, imported.camera, stated, c.parse.max_side_px)
        start_time = time.perf_counter()
        prepared = _prepare(imported, picture, c.refine, c.compose)
        if picture is not None and camera is None:
            note = f"the camera of the photograph is taken from {file.name}"
            prepared = replace(prepared, notes=(*prepared.notes, note))
        with RunFolder(out, c) as run:
            run.record("photo", name=file.name if photo is None else photo.name)
            with Pictures(run, c.render) as pictures:
                context = StepContext(run, c, None, None, pictures)
                _write_composed(context, file, prepared, picture)
                refine_layout(context)
                export_files(context)
            scene = read_scene(run.path / SCENE)
            fallbacks = (f"{e['what']}: {e['why']}" for e in run.data["fallbacks"])
            notes, seconds = (*prepared.notes, *fallbacks), time.perf_counter() - start_time
            passed = bool(read_object(run.path / RESULT, RunError)["passed"])
            rescued = _result(prepared, scene, passed, picture, notes, seconds)
            if picture is not None:
                outlines = outline_picture(picture.rgb, prepared.given, scene)
                write_output(out / OUTLINE_PICTURE, to_png(outlines), RunError)
            write_output(out / REPORT, json.dumps(rescued.to_json(), indent=1) + "\n", RunError)
            finish(run, None)
    return rescued


def _prepare(
    imported: ImportedScene, photo: Photographed | None, o: RefineOptions, c: ComposeOptions
) -> PreparedScene:
    """Put the objects of a scene onto supports, and align them with the photograph."""
    given, camera = imported.spec, None
    if photo is not None:
        given = transformed_scene(given, photo.view.scene_transform)
    supports = find_supports(given)
    if photo is not None:
        # The top of the main support is at z = 0, as in scenes of photographs.
        to_ground = pose((0.0, 0.0, -_main_top(supports)))
        height = photo.view.camera.height + float(to_ground.pos[2])
        camera = photo.view.camera.model_copy(update={"height": height})
        shifted = transformed_scene(supports.scene, to_ground).model_copy(update={"camera": camera})
        supports = replace(supports, scene=shifted)
    before = measured(supports.scene, o)
    deep = {
        name
        for pair, depth in before.depths_m.items()
        if depth > o.max_depth_m
        for name in pair.split("|")
    }
    resting = [
        item.name
        for item in supports.scene.objects
        if not item.static
        and item.name not in deep
        and before.drift_m[item.name] <= RESTS_M
        and before.tilt_deg[item.name] <= RESTS_DEG
    ]
    supported = with_supports(supports, resting=resting, sizes=c.mesh_sizes)
    composed, notes, alignment = supported.scene, (*imported.notes, *supported.notes), None
    if photo is not None and c.align.enabled:
        unsized = with_supports(supports, resting=resting)
        # The given camera does not change.
        keeps_camera = c.align.model_copy(update={"camera": False})
        alignment = align(unsized.scene, photo.rgb, keeps_camera)
        aligned, contact_notes = in_contact(alignment.scene, c)
        unaligned_error, aligned_error = (_median_outline(s, photo) for s in (composed, aligned))
        if aligned_error > unaligned_error:
            alignment = None
            refused = (
                f"outlines would be {aligned_error:.1f} px off instead of {unaligned_error:.1f} px"
            )
            notes = (*notes, f"the alignment is not applied: {refused}")
        else:
            supported, composed = unsized, aligned
            notes = (*imported.notes, *supported.notes, *contact_notes)
    return PreparedScene(supports.scene, before, supported.scene, alignment, composed, notes)


def _median_outline(scene: SceneSpec, photo: Photographed) -> float:
    """Return the median of the objects' outline errors [px]; 0 if all are unknown."""
    errors = [error for error in outline_errors(scene, photo.rgb).values() if error is not None]
    return float(np.median(errors)) if errors else 0.0


def _main_top(supports: FoundSupports) -> float:
    """Return the height of the top of the support that carries most objects [m]."""
    carried = list(supports.parents.values())
    main = max(
        (item for item in supports.scene.objects if item.static),
        key=lambda item: carried.count(item.name),
    )
    return main.z + float(bounds(main.spec, main.joint_state, main.base_tilt)[1][2])


def _write_composed(
    context: StepContext, file: Path, start: PreparedScene, photo: Photographed | None
) -> None:
    """Write the given and the composed scene of a rescue as the step `compose`."""
    run = context.run
    with run.step("compose", {"file": file, "options": context.config.compose}) as out:
        assert out is not None  # The folder is new.
        (out / "compose").mkdir()
        if photo is not None:
            (out / PHOTO).write_bytes(to_png(photo.rgb))
            if start.alignment is not None:
                write_alignment(run, start.supported, start.alignment, photo.rgb, out)
        (out / GIVEN_SCENE).write_text(start.given.to_json(), encoding="utf-8")
        (out / COMPOSED).write_text(start.composed.to_json(), encoding="utf-8")
        for note in start.notes:
            run.note("compose", note, f"read from {file.name}")
    if photo is not None:
        context.pictures.begin("compose/given", run.path / GIVEN_SCENE, GIVEN_PICTURE)
    context.pictures.begin("compose/picture", run.path / COMPOSED, "pictures/before.png")


def _result(
    start: PreparedScene,
    scene: SceneSpec,
    passed: bool,
    photo: Photographed | None,
    notes: tuple[str, ...],
    seconds: float,
) -> Rescued:
    """Return the rescued scene and its differences from the given scene."""
    free = [item.name for item in scene.objects if not item.static]
    moves = object_moves(start.given, scene)
    outlines: dict[str, dict[str, float | None]] = {}
    if photo is not None:
        given, rescued = (outline_errors(s, photo.rgb) for s in (start.given, scene))
        outlines = {name: {"given": given.get(name), "rescued": rescued.get(name)} for name in free}
    return Rescued(
        scene,
        passed,
        start.before,
        {name: moves[name].distance_m for name in free},
        {name: moves[name].turn_deg for name in free},
        {name: moves[name].size_ratio for name in free},
        outlines,
        notes,
        seconds,
    )

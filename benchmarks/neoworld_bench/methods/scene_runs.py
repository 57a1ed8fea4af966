"""Runs of methods on scenes from initial scenes, in separate processes, with one row per run."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neoworld_mjx.errors import RunError, SpecError, choices
from neoworld_mjx.measure import visible_box_iou
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.places import HERE, Place
from neoworld_mjx.spec import SceneSpec

from ..dataset.declaration import declaration, declarations
from ..dataset.truth_scene import photographed
from ..fidelity.rendered_scenes import photograph
from ..noise.parse_noise import NoiseLog
from ..row_files import stored_rows
from .layout_errors import layout_errors
from .method_runs import MethodJob, MethodRow, RunSettings, run_jobs
from .part_depths import P_PEN_M
from .scene_methods import MethodResult, check_methods, outcomes_of
from .scene_objects import OBJECTS, ObjectRow, object_rows
from .submission import submission_name, submitted, submitted_starts
from .validity import Validity, validity

RESULTS = "results.parquet"


class SceneRow(MethodRow):
    """Result of one method on one scene from one initial scene."""

    scene: str
    room: str
    tabletop: bool
    objects: int
    """Movable objects of the ground truth."""
    refused: str
    """Kinds of errors that were sampled but not injected, because no variant passes the checks;
    comma-separated."""
    missed: int
    """Number of movable objects of the ground truth that the result lacks."""
    extra: int
    """Number of movable objects of the result that the ground truth lacks."""
    valid: bool
    """True if the result passes the final check, no object is displaced, and no object that the
    method was given is missed; see `validity`.
    """
    check_passed: bool
    """True if the result passes the final check."""
    accepted: bool | None
    """Verdict of the search, which also requires that no object settled away from its composed
    position; None for methods without a search."""
    displaced: int
    """Number of objects that have toppled or fallen compared with the ground truth."""
    s_pen: int
    """1 if two objects penetrate deeper than the bound in the result, else 0."""
    s_stab: bool
    o_stab: float
    """Fraction of the movable objects whose drift and tilt stay within the bounds."""
    articulated: int
    """Number of objects with joints that move."""
    p_pen: int
    """Number of articulated objects in which two parts penetrate deeper than 1 mm, over the ranges
    of the joints."""
    max_depth_m: float
    max_drift_m: float
    max_tilt_deg: float
    xy_error_m: float
    yaw_error_deg: float
    scale_error: float
    edge_error: float
    """Error of an object's three edges, whereas `scale_error` is the error of its diagonal; see
    `layout_errors`."""
    box_iou: float
    """Intersection over union of visible 2D boxes with those of the ground truth, as a mean over
    objects."""
    seconds_to_valid: float | None
    """Time until the first valid candidate [s]; None if the result is not valid."""
    seconds: float | None
    """Time of the method [s]; None if a submission does not state it."""

    @property
    def found(self) -> int:
        """Number of movable objects of the ground truth in the result; errors are means of them."""
        return self.objects - self.missed

    @property
    def subject(self) -> str:
        """Name of the scene."""
        return self.scene

    @property
    def summary(self) -> str:
        """One line for the log."""
        valid = "valid" if self.valid else "not valid"
        time = "" if self.seconds is None else f", {self.seconds:.1f} s"
        error = f"{1e3 * self.xy_error_m:.1f} mm"
        return f"{self.scene} start {self.start} {self.method}: {valid}, {error}{time}"


def chosen_scenes(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the chosen scenes.

    Args:
        names: names of scenes. If empty, all scenes are chosen. If it is a single number, this many
            scenes are chosen, evenly spaced in the list.

    Raises:
        SpecError: there is no scene of this name, or there are fewer scenes than the number.
    """
    every = tuple(declarations())
    if len(names) == 1 and names[0].isdecimal():
        count = int(names[0])
        if not 1 <= count <= len(every):
            raise SpecError(f"scenes: got {count}, valid is from 1 to {len(every)}")
        return tuple(every[int(k * len(every) / count)] for k in range(count))
    for name in names:
        if name not in every:
            raise SpecError(f"scenes: {choices(name, every)}")
    return tuple(names) or every


def run_scenes(
    scenes: Sequence[str],
    methods: Sequence[str],
    settings: RunSettings,
    *,
    starts: int,
    place: Place = HERE,
    out: Path | None = None,
    submission: Path | None = None,
) -> list[SceneRow]:
    """Run methods on scenes, except for rows that the folder's file already contains.

    Args:
        scenes: names of the scenes.
        methods: names of methods, as for `check_methods`.
        settings: settings of the run.
        starts: number of initial scenes of each scene.
        place: where the methods run.
        out: folder of `results.parquet`. If None, rows are not stored.
        submission: folder of submitted scenes, which are scored (again in each run) instead of
            running methods.

    Raises:
        SpecError: a method is unknown, or the submission cannot be read.
        RunError: as for `run_jobs`.
    """
    if submission is None:
        check_methods(methods, [name for name, _ in settings.named])
        starts_of = dict.fromkeys(scenes, range(starts))
    else:
        methods = (submission_name(submission),)
        starts_of = {name: submitted_starts(submission, name, starts) for name in scenes}
    return run_jobs(
        scene_rows,
        SceneRow,
        fingerprints={
            name: settings.fingerprint(declaration(name).model_dump(mode="json")) for name in scenes
        },
        starts=starts_of,
        methods=methods,
        settings=settings,
        place=place,
        file=out and out / RESULTS,
        objects=out and out / OBJECTS,
        submission=submission,
    )


def scene_rows(job: MethodJob) -> Iterator[tuple[SceneRow, list[ObjectRow]]]:
    """Run the methods of a job; yield each row with the rows of its objects."""
    truth, refine = photographed(declaration(job.subject)), job.settings.refine
    errors = NoiseLog()
    for method, result, initial in _outcomes(job, truth, errors):
        key = job.subject, job.start, job.settings.seed, method
        objects = object_rows(result.scene, result.measure, key)
        verdict = validity(result.scene, result.measure, truth, refine, given=initial)
        yield _row(job, method, result, truth, verdict, objects, errors), objects


def _outcomes(
    job: MethodJob, truth: SceneSpec, errors: NoiseLog
) -> Iterator[tuple[str, MethodResult, SceneSpec | None]]:
    """Yield each method with its result and its initial scene, which is None for a submission."""
    s = job.settings
    if job.submission is not None:
        yield job.methods[0], submitted(job.submission, job.start, truth, s.refine), None
        return
    initial = job.initial(truth, job.subject, errors)
    engine = NativeEngine(threads=job.threads)
    for method, result in outcomes_of(
        job.methods,
        initial.scene,
        s.refine,
        engine,
        lambda: photograph(truth),
        align=s.compose.align,
        programs=initial.programs,
        seed=s.seed,
        named=dict(s.named),
    ):
        yield method, result, initial.scene


def _row(
    job: MethodJob,
    method: str,
    result: MethodResult,
    truth: SceneSpec,
    verdict: Validity,
    objects: Sequence[ObjectRow],
    errors: NoiseLog,
) -> SceneRow:
    declared, m = declaration(job.subject), result.measure
    o = job.settings.refine
    still = [
        m.drift_m[name] < o.max_drift_m and m.tilt_deg[name] < o.max_tilt_deg for name in m.drift_m
    ]
    # Boxes are compared in the camera of the result, which is the fitted camera of the response.
    true_objects = {item.name: item for item in truth.objects}
    with_true_boxes = []
    for item in result.scene.objects:
        # An object that the ground truth lacks has no box, but can hide other objects.
        true = true_objects.get(item.name)
        box = {"box2d": None} if true is None else {"box2d": true.box2d, "occluded": true.occluded}
        with_true_boxes.append(item.model_copy(update=box))
    compared = result.scene.model_copy(update={"objects": tuple(with_true_boxes)})
    part_depths = [o.part_depth_m for o in objects if o.part_depth_m is not None]
    columns: dict[str, Any] = {
        **job.columns(method, errors),
        **layout_errors(result.scene, truth),
    }
    return SceneRow(
        **columns,
        scene=job.subject,
        room=declared.room,
        tabletop=declared.tabletop,
        objects=len(declared.movable()),
        refused=", ".join(errors.refused),
        missed=len(verdict.missed),
        extra=len(verdict.extra),
        valid=verdict.valid,
        check_passed=verdict.check_passed,
        accepted=result.accepted,
        displaced=len(verdict.displaced),
        s_pen=m.s_pen or 0,
        s_stab=bool(m.s_stab),
        o_stab=float(np.mean(still)),
        articulated=len(part_depths),
        p_pen=sum(depth > P_PEN_M for depth in part_depths),
        max_depth_m=m.max_depth_m,
        max_drift_m=min(m.max_drift_m, 1e6),
        max_tilt_deg=min(m.max_tilt_deg, 1e6),
        box_iou=float(np.mean(list(visible_box_iou(compared).values()))),
        seconds_to_valid=result.seconds_to_result if verdict.valid else None,
        seconds=result.seconds,
        rollouts=result.rollouts,
    )


def known_rows(folder: Path) -> list[SceneRow]:
    """Read the rows of a folder.

    Raises:
        RunError: the folder has no rows, they cannot be read, or a method has rows with different
            options or scenes.
    """
    rows = stored_rows(folder / RESULTS, SceneRow)
    marks: dict[tuple[str, str], str] = {}
    for row in rows:
        if marks.setdefault((row.method, row.scene), row.fingerprint) != row.fingerprint:
            raise RunError(
                f"{folder / RESULTS} has rows of {row.method} on {row.scene} with different "
                "options or scenes: run them again into a new folder"
            )
    return rows

"""Runs of methods over scenes and initial scenes, in separate processes, with a row of each."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neoworld_mjx.config import ComposeOptions, RefineOptions
from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.io.files import content_hash
from neoworld_mjx.measure import visible_box_iou
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.spec import SceneSpec

from ..dataset.declaration import declaration, declarations
from ..dataset.truth_scene import photographed
from ..fidelity.rendered_responses import exact_response
from ..noise.initial_scenes import (
    NoiseLevel,
    composed_start,
    is_evaluation,
    noise_number,
)
from ..noise.parse_noise import NoiseLog
from ..row_files import RowFile, check_level, made_by_jobs, sized, stored_rows
from ..rows import Row, log
from .layout_errors import layout_errors
from .part_depths import P_PEN_M
from .scene_methods import MethodResult, check_methods, outcomes_of
from .scene_objects import OBJECTS, ObjectRow, object_rows
from .submission import submission_name, submitted, submitted_starts
from .validity import Validity, validity

RESULTS = "results.parquet"


class SceneRow(Row):
    """Result of one method on one scene from one initial scene."""

    scene: str
    room: str
    tabletop: bool
    objects: int
    """Movable objects of the ground truth."""
    noise: str
    """Noise level of the initial scene."""
    injected: str
    """Kinds of errors of the initial scene other than its numbers, comma-separated; see
    `parse_noise`."""
    refused: str
    """Kinds that were drawn, but of which no variant passes the checks."""
    missed: int
    """Number of them that the initial scene lacks."""
    extra: int
    """Movable objects of the initial scene that the ground truth does not have."""
    start: int
    seed: int
    evaluation: bool
    """True if the initial scene is in the evaluation half."""
    method: str
    valid: bool
    """True if the result passes the final check, no object is displaced, and none that the method
    was given is missed; see `validity`.
    """
    check_passed: bool
    """True if it passes the final check alone."""
    accepted: bool | None
    """Verdict of a search itself, which also requires that nothing settled away from where it was
    composed; None for other methods."""
    displaced: int
    """Objects that are toppled or have fallen from where the ground truth has them."""
    s_pen: int
    """1 if two objects are deeper than the bound in the result."""
    s_stab: bool
    o_stab: float
    """Share of the movable objects that stay within the bounds."""
    articulated: int
    """Objects with joints that move."""
    p_pen: int
    """Articulated objects of which two parts are deeper than 1 mm over the joints' ranges."""
    max_depth_m: float
    max_drift_m: float
    max_tilt_deg: float
    xy_error_m: float
    yaw_error_deg: float
    scale_error: float
    box_iou: float
    """Overlap of visible boxes with the ground truth's, mean over objects."""
    seconds_to_valid: float | None
    """Time at the first valid candidate; None where the result is not valid."""
    seconds: float | None
    """Time of the method; None if a submission does not state it."""
    rollouts: int
    fingerprint: str
    """Hash of the scene's declaration, of the noise and of the options."""

    @property
    def found(self) -> int:
        """Number of the ground truth's movable objects in the initial scene, over which errors are
        means."""
        return self.objects - self.missed


@dataclass(frozen=True)
class SceneTask:
    """Methods to run on one scene from one initial scene."""

    scene: str
    start: int
    methods: tuple[str, ...]
    seed: int
    refine: RefineOptions
    compose: ComposeOptions
    noise: NoiseLevel
    threads: int
    submission: Path | None = None
    """Folder of another method's scenes."""


SceneRows = tuple[SceneRow, list[ObjectRow]]
"""Row of a scene, and the rows of its objects."""


def chosen_scenes(names: Sequence[str]) -> tuple[str, ...]:
    """Return the scenes with these names: all for no names, evenly spaced ones for a single number.

    Raises:
        SpecError: there is no such scene, or there are not so many.
    """
    every = tuple(declarations())
    if len(names) == 1 and names[0].isdecimal():
        count = int(names[0])
        if not 1 <= count <= len(every):
            raise SpecError(f"scenes: there are 1 to {len(every)} to take, not {count}")
        return tuple(every[int(k * len(every) / count)] for k in range(count))
    for name in names:
        if name not in every:
            raise SpecError(f"scenes: {choices(name, every)}")
    return tuple(names) or every


def run_scenes(
    scenes: Sequence[str],
    methods: Sequence[str],
    *,
    starts: int,
    seed: int,
    refine: RefineOptions,
    compose: ComposeOptions,
    noise: NoiseLevel,
    workers: int = 0,
    out: Path | None = None,
    submission: Path | None = None,
) -> list[SceneRow]:
    """Run methods, except for rows that the folder's file already contains.

    Args:
        scenes: names.
        methods: of METHODS.
        starts: number of starts of each scene.
        seed: of noise and searches.
        refine: options of the search and of the final check.
        compose: options of composition.
        noise: level of the starts' noise.
        workers: processes; 0 takes one for every two cores.
        out: folder of `results.parquet`; None keeps nothing.
        submission: folder of scenes to score in place of running methods, anew each time.

    Raises:
        SpecError: there is no such method, or the submission cannot be read.
        RunError: the file cannot be read or written or has rows of another noise, or a scene's
            process died.
    """
    if submission is None:
        check_methods(methods)
    else:
        methods = (submission_name(submission),)
    kept = RowFile(None if out is None else out / RESULTS, SceneRow, _key)
    check_level(kept, noise)
    objects = RowFile(None if out is None else out / OBJECTS, ObjectRow, lambda row: row.key)
    prints = {name: _fingerprint(name, noise, refine, compose) for name in scenes}
    done = {
        (r.scene, r.start, r.seed, r.method)
        for r in kept.rows
        if prints.get(r.scene) == r.fingerprint
    }
    workers, threads = sized(workers)
    tasks = []
    for name in scenes:
        own_starts = submitted_starts(submission, name, starts) if submission else range(starts)
        for k in own_starts:
            own = tuple(m for m in methods if submission or (name, k, seed, m) not in done)
            if own:
                tasks.append(
                    SceneTask(name, k, own, seed, refine, compose, noise, threads, submission)
                )
    for row, own in made_by_jobs(scene_rows, tasks, workers):
        log.info(_line(row))
        # Objects first: a scene whose row is there has the rows of its objects, too.
        objects.put(own, in_place_of=_key(row))
        kept.put([row], in_place_of=_key(row))
    return sorted(
        (
            r
            for r in kept.rows
            if r.scene in scenes
            and r.fingerprint == prints[r.scene]
            and r.method in methods
            and r.seed == seed
            and r.start < starts
        ),
        key=_key,
    )


def scene_rows(task: SceneTask) -> Iterator[SceneRows]:
    """Run the methods of a scene; yield each row with those of its objects."""
    truth = photographed(declaration(task.scene))
    log_of_noise = NoiseLog()
    for method, result, given in _outcomes(task, truth, log_of_noise):
        key = task.scene, task.start, task.seed, method
        objects = object_rows(result.scene, result.measure, key)
        verdict = validity(result.scene, result.measure, truth, task.refine, given=given)
        yield _row(task, method, result, truth, verdict, objects, log_of_noise), objects


def _outcomes(
    task: SceneTask, truth: SceneSpec, log_of_noise: NoiseLog
) -> Iterator[tuple[str, MethodResult, SceneSpec | None]]:
    """Yield each method with its result and its initial scene; None for a submission."""
    if task.submission is not None:
        yield task.methods[0], submitted(task.submission, task.start, truth, task.refine), None
        return
    number = noise_number(task.scene, task.seed, task.start)
    composed = composed_start(
        truth, exact_response(truth), number, task.compose, noise=task.noise, log=log_of_noise
    )
    engine = NativeEngine(threads=task.threads)
    for method, result in outcomes_of(task.methods, composed, task.refine, engine, seed=task.seed):
        yield method, result, composed


def _row(
    task: SceneTask,
    method: str,
    result: MethodResult,
    truth: SceneSpec,
    verdict: Validity,
    objects: Sequence[ObjectRow],
    log_of_noise: NoiseLog,
) -> SceneRow:
    declared, m = declaration(task.scene), result.measure
    o = task.refine
    still = [
        m.drift_m[name] < o.max_drift_m and m.tilt_deg[name] < o.max_tilt_deg for name in m.drift_m
    ]
    # Its own camera: that of the response, as fitted.
    seen = {item.name: item for item in truth.objects}
    shown = []
    for item in result.scene.objects:
        # What is not in the ground truth has no box to agree with, but hides others.
        true = seen.get(item.name)
        box = {"box2d": None} if true is None else {"box2d": true.box2d, "occluded": true.occluded}
        shown.append(item.model_copy(update=box))
    photographed_as = result.scene.model_copy(update={"objects": tuple(shown)})
    part_depths = [o.part_depth_m for o in objects if o.part_depth_m is not None]
    return SceneRow(
        scene=task.scene,
        room=declared.room,
        tabletop=declared.tabletop,
        objects=len(declared.movable()),
        noise=task.noise,
        injected=", ".join(log_of_noise.injected),
        refused=", ".join(log_of_noise.refused),
        missed=len(verdict.missed),
        extra=len(verdict.extra),
        start=task.start,
        seed=task.seed,
        evaluation=is_evaluation(task.start),
        method=method,
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
        **layout_errors(result.scene, truth),
        box_iou=float(np.mean(list(visible_box_iou(photographed_as).values()))),
        seconds_to_valid=result.seconds_to_result if verdict.valid else None,
        seconds=result.seconds,
        rollouts=result.rollouts,
        fingerprint=_fingerprint(task.scene, task.noise, task.refine, task.compose),
    )


def _fingerprint(
    name: str, noise: NoiseLevel, refine: RefineOptions, compose: ComposeOptions
) -> str:
    parts = [declaration(name), refine, compose]
    return content_hash([noise, *(part.model_dump(mode="json") for part in parts)])[:16]


def known_rows(folder: Path) -> list[SceneRow]:
    """Read the rows of a folder.

    Raises:
        RunError: it has none, or they cannot be read.
    """
    return stored_rows(folder / RESULTS, SceneRow)


def _key(row: SceneRow) -> tuple[str, int, int, str]:
    return row.scene, row.start, row.seed, row.method


def _line(row: SceneRow) -> str:
    valid = "valid" if row.valid else "not valid"
    time = "" if row.seconds is None else f", {row.seconds:.1f} s"
    return (
        f"{row.scene} start {row.start} {row.method}: {valid}, {1e3 * row.xy_error_m:.1f} mm{time}"
    )

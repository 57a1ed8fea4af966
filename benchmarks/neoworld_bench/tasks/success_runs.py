"""Task success of methods: each task is reconstructed from noisy initial scenes, planned there and
executed. As in the scene benchmark, the ground-truth scene is photographed, a noisy response is
composed, and a method turns it into a layout. A row reports whether the plan made in this layout
solves the task in the ground truth."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from neoworld_mjx.config import ComposeOptions, RefineOptions
from neoworld_mjx.io.files import content_hash
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.spec import SceneSpec

from ..fidelity.rendered_responses import exact_response
from ..methods.scene_methods import MethodResult, check_methods, in_order, outcomes_of
from ..methods.validity import validity
from ..noise.initial_scenes import (
    NoiseLevel,
    composed_start,
    is_evaluation,
    noise_number,
)
from ..noise.parse_noise import NoiseLog
from ..row_files import RowFile, check_level, made_by_jobs, sized, stored_rows
from ..rows import Row, log
from .catalogue import find_task
from .reconstructed_plans import PlannedThere, described, failed, planned_there
from .task import ManipulationTask
from .task_photo import VIEW, TaskPhoto, photographed_task

SUCCESSES = "tasks.parquet"


class SuccessRow(Row):
    """Result of one method on one task from one initial scene."""

    task: str
    kind: str
    objects: int
    """Number of objects of the ground truth without its table."""
    noise: str
    """Noise level of the initial scene."""
    injected: str
    """Kinds of errors of the initial scene other than its numbers, comma-separated; see
    `parse_noise`."""
    missed: int
    """Number of them that the initial scene lacks."""
    start: int
    seed: int
    evaluation: bool
    """True if the initial scene is in the evaluation half."""
    method: str
    on_truth: bool
    """True if the plan made in the result solves the task in the ground truth: task success."""
    in_scene: bool
    """True if it solves the task in the result."""
    unaligned: bool
    """True if it does so without removing the offset that all objects share."""
    reason: str
    """Reason of failure in the ground truth; empty on success."""
    scene_reason: str
    """Reason of failure in the result."""
    progress: float
    """Progress at the end in the ground truth, in [0, 1]."""
    valid: bool
    """True if the result passes the final check, and no object is displaced."""
    shift_m: float
    """Length of the offset that all objects share."""
    object_error_m: float | None
    """Horizontal error of the task's object, less the common offset."""
    seconds: float
    """Time of the method, compiling included."""
    executing_s: float
    """Time of planning and of three executions."""
    rollouts: int
    fingerprint: str
    """Hash of the task, its camera, the noise and the options."""


@dataclass(frozen=True)
class SuccessJob:
    """Methods to run on one task from one initial scene."""

    task: str
    start: int
    methods: tuple[str, ...]
    seed: int
    refine: RefineOptions
    compose: ComposeOptions
    noise: NoiseLevel
    threads: int
    fingerprint: str


def run_successes(
    tasks: Sequence[ManipulationTask],
    methods: Sequence[str],
    *,
    starts: int,
    seed: int,
    refine: RefineOptions,
    compose: ComposeOptions,
    noise: NoiseLevel,
    workers: int = 0,
    out: Path | None = None,
) -> list[SuccessRow]:
    """Run methods on tasks, except for rows that the folder's file already contains.

    Args:
        tasks: what is to be done.
        methods: of scene_methods.METHODS.
        starts: number of starts of each task.
        seed: of noise and searches.
        refine: options of the search and of the final check.
        compose: options of composition.
        noise: level of the starts' noise.
        workers: processes; 0 takes one for every two cores.
        out: folder of `tasks.parquet`; None keeps nothing.

    Raises:
        RunError: the file cannot be read or written or has rows of another noise, or a process
            died.
    """
    check_methods(methods)
    kept = RowFile(None if out is None else out / SUCCESSES, SuccessRow, _key)
    check_level(kept, noise)
    prints = {task.name: _fingerprint(task, noise, refine, compose) for task in tasks}
    known = [row for row in kept.rows if prints.get(row.task) == row.fingerprint]
    done = {_key(row) for row in known}
    workers, threads = sized(workers)
    jobs = []
    for start in range(starts):
        for name, fingerprint in prints.items():
            own = tuple(m for m in methods if (name, start, seed, m) not in done)
            if own:
                jobs.append(
                    SuccessJob(name, start, own, seed, refine, compose, noise, threads, fingerprint)
                )
    for row in made_by_jobs(success_rows, jobs, workers):
        log.info(_line(row))
        kept.put([row], in_place_of=_key(row))
    wanted = {(name, k, seed, m) for name in prints for k in range(starts) for m in methods}
    rows = [r for r in kept.rows if _key(r) in wanted and r.fingerprint == prints[r.task]]
    return sorted(rows, key=_key)


def success_rows(job: SuccessJob) -> Iterator[SuccessRow]:
    """Run the methods of a job and yield a row for each; exceptions count as failures."""
    task = find_task(job.task)
    left, errors = in_order(job.methods), NoiseLog()
    row = partial(_row, job, task, errors)
    try:
        photo = photographed_task(task.scene)
        number = noise_number(f"task/{job.task}", job.seed, job.start)
        tree = exact_response(photo.scene)
        composed = composed_start(
            photo.scene, tree, number, job.compose, noise=job.noise, log=errors
        )
    except Exception as error:  # Of one task, which must not end the run of all others.
        for method in left:
            yield row(method, f"no start: {described(error)}")
        return
    engine = NativeEngine(threads=job.threads)
    while left:
        try:
            for method, result in outcomes_of(
                tuple(left), composed, job.refine, engine, seed=job.seed, warm=False
            ):
                left.remove(method)
                yield row(method, (photo, composed, result))
        except Exception as error:
            yield row(left.pop(0), f"no layout: {described(error)}")


def _row(
    job: SuccessJob,
    task: ManipulationTask,
    errors: NoiseLog,
    method: str,
    made: tuple[TaskPhoto, SceneSpec, MethodResult] | str,
) -> SuccessRow:
    valid, missed, seconds, rollouts = False, 0, 0.0, 0
    if isinstance(made, str):
        nothing = failed(made)
        there = PlannedThere(nothing, nothing, nothing, 0.0, None, 0.0)
    else:
        photo, given, result = made
        scene = photo.back(result.scene)
        there = planned_there(task, scene)
        valid = validity(scene, result.measure, task.scene, job.refine, given=given).valid
        missed = len(_things(task.scene) - _things(scene))
        seconds, rollouts = result.seconds or 0.0, result.rollouts
    return SuccessRow(
        task=task.name,
        kind=task.kind,
        objects=len(_things(task.scene)),
        noise=job.noise,
        injected=", ".join(errors.injected),
        missed=missed,
        start=job.start,
        seed=job.seed,
        evaluation=is_evaluation(job.start),
        method=method,
        on_truth=there.on_truth.success,
        in_scene=there.in_scene.success,
        unaligned=there.unaligned.success,
        reason=there.on_truth.reason,
        scene_reason=there.in_scene.reason,
        progress=there.on_truth.progress,
        valid=valid,
        shift_m=there.shift_m,
        object_error_m=there.object_error_m,
        seconds=seconds,
        executing_s=there.seconds,
        rollouts=rollouts,
        fingerprint=job.fingerprint,
    )


def _things(scene: SceneSpec) -> set[str]:
    return {item.name for item in scene.objects if not item.environment}


def _fingerprint(
    task: ManipulationTask, noise: NoiseLevel, refine: RefineOptions, compose: ComposeOptions
) -> str:
    parts = [task.scene, task.predicate, task.plan, refine, compose]
    return content_hash([noise, VIEW, *(part.model_dump(mode="json") for part in parts)])[:16]


def known_successes(folder: Path) -> list[SuccessRow]:
    """Read the rows of a folder, none if it has no such file.

    Raises:
        RunError: they cannot be read.
    """
    file = folder / SUCCESSES
    return stored_rows(file, SuccessRow) if file.exists() else []


def _key(row: SuccessRow) -> tuple[str, int, int, str]:
    return row.task, row.start, row.seed, row.method


def _line(row: SuccessRow) -> str:
    done = "done" if row.on_truth else f"not done ({row.reason})"
    return f"{row.task} start {row.start} {row.method}: {done}, {row.seconds:.1f} s"

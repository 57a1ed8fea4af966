"""Task success of methods: each task is reconstructed from noisy initial scenes, planned there and
executed. As in the scene benchmark, the ground-truth scene is photographed, a noisy response is
composed, and a method turns it into a layout. A row reports whether the plan made in this layout
solves the task in the ground truth. The method `truth` is the ground truth itself: its rows report
whether the reference plans succeed."""

from collections.abc import Iterator, Sequence
from functools import partial

from neoworld_mjx.measure import measured
from neoworld_mjx.places import HERE, Place
from neoworld_mjx.spec import SceneSpec

from ..fidelity.rendered_scenes import photograph
from ..methods.layout_errors import validity
from ..methods.method_runs import MethodJob, MethodRow, RunSettings, run_jobs
from ..methods.scene_methods import MethodResult, check_methods
from ..noise.parse_noise import NoiseLog
from ..rows import RowStore
from .catalogue import find_task
from .reconstructed_plans import PlannedThere, described, failed, planned_there
from .task import ManipulationTask
from .task_photo import VIEW, TaskPhoto, photographed_task

TRUTH = "truth"
"""Name of the method whose result is the ground truth."""


class SuccessRow(MethodRow):
    """Result of one method on one task from one initial scene."""

    task: str
    kind: str
    objects: int
    """Number of objects of the ground truth without its table."""
    missed: int
    """Number of them that the result lacks."""
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

    @property
    def subject(self) -> str:
        """Name of the task."""
        return self.task

    @property
    def summary(self) -> str:
        """Line of the log."""
        done = "done" if self.on_truth else f"not done ({self.reason})"
        return f"{self.task} start {self.start} {self.method}: {done}, {self.seconds:.1f} s"


def run_successes(
    tasks: Sequence[ManipulationTask],
    methods: Sequence[str],
    settings: RunSettings,
    *,
    starts: int,
    place: Place = HERE,
    store: RowStore | None = None,
) -> list[SuccessRow]:
    """Run methods on tasks, except for rows that are already stored.

    Args:
        tasks: manipulation tasks.
        methods: of scene_methods.METHODS, and TRUTH.
        settings: of the run.
        starts: number of initial scenes of each task.
        place: where they run.
        store: stored rows, to which new ones are added. If None, rows are not stored.

    Raises:
        SpecError: a method is unknown.
        RunError: as for `run_jobs`.
    """
    check_methods(methods, [TRUTH])
    return run_jobs(
        success_rows,
        SuccessRow,
        fingerprints={
            task.name: settings.fingerprint(
                VIEW,
                *(p.model_dump(mode="json") for p in (task.scene, task.predicate, task.plan)),
            )
            for task in tasks
        },
        starts={task.name: range(starts) for task in tasks},
        methods=methods,
        settings=settings,
        place=place,
        store=store,
    )


def success_rows(job: MethodJob) -> Iterator[SuccessRow]:
    """Run the methods of a job and yield a row for each; exceptions count as failures."""
    task, errors = find_task(job.subject), NoiseLog()
    row = partial(_row, job, task, errors)
    remaining = [method for method in job.methods if method != TRUTH]
    try:
        photo = photographed_task(task.scene)
        initial = job.initial(photo.scene, f"task/{task.name}", errors) if remaining else None
    except Exception as error:  # An error of one task must not end the run of all others.
        for method in job.methods:
            yield row(method, f"no start: {described(error)}")
        return
    if TRUTH in job.methods:
        measure = measured(photo.scene, job.settings.refine)
        yield row(TRUTH, (photo, photo.scene, MethodResult(photo.scene, measure, 0.0, 0.0)))
    while initial is not None and remaining:
        picture = lambda: photograph(photo.scene)
        try:
            for method, result in job.outcomes(tuple(remaining), initial, picture, warm=False):
                remaining.remove(method)
                yield row(method, (photo, initial.scene, result))
        except Exception as error:
            yield row(remaining.pop(0), f"no layout: {described(error)}")


def _row(
    job: MethodJob,
    task: ManipulationTask,
    errors: NoiseLog,
    method: str,
    outcome: tuple[TaskPhoto, SceneSpec, MethodResult] | str,
) -> SuccessRow:
    valid, missed, seconds, rollouts = False, 0, 0.0, 0
    if isinstance(outcome, str):
        failure = failed(outcome)
        there = PlannedThere(failure, failure, failure, 0.0, None, 0.0)
    else:
        photo, initial, result = outcome
        scene = photo.back(result.scene)
        there = planned_there(task, scene)
        valid = validity(
            scene, result.measure, task.scene, job.settings.refine, given=initial
        ).valid
        missed = len(_object_names(task.scene) - _object_names(scene))
        seconds, rollouts = result.seconds or 0.0, result.rollouts
    return SuccessRow(
        **job.columns(method, errors),
        task=task.name,
        kind=task.kind,
        objects=len(_object_names(task.scene)),
        missed=missed,
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
    )


def _object_names(scene: SceneSpec) -> set[str]:
    return {item.name for item in scene.objects if not item.environment}

"""Task success of methods: tasks planned in reconstructions, and executed there and in the truth.

As in the scene benchmark, the ground-truth scene is photographed, a noisy response is composed, and
a method turns it into a layout. A row reports whether the plan made in this layout solves the task
in the ground truth. The method `truth` is the ground truth itself: its rows report whether the
reference plans succeed.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.environments.predicates import Predicate
from neoworld_mjx.environments.samples import sample
from neoworld_mjx.measure import measured
from neoworld_mjx.spec import SceneSpec

from ..methods.layout_errors import offsets, validity
from ..methods.method_runs import MethodJob, MethodRow
from ..methods.scene_methods import MethodResult
from ..noise.parse_noise import NoiseLog
from .catalogue import find_task
from .execution import Outcome, execute
from .plan_format import TaskPlan
from .plan_reliability import sampled_plans, truth_samples
from .task import ManipulationTask
from .task_scenes import TaskPhoto, photographed_task


@dataclass(frozen=True)
class PlannedThere:
    """Outcomes of a plan made in a reconstruction."""

    on_truth: Outcome
    """Outcome in the ground truth, of the plan corrected by the common offset: task success."""
    in_scene: Outcome
    """Outcome in the reconstruction."""
    unaligned: Outcome
    """Outcome in the ground truth, of the plan without correction."""
    shift_m: float
    """Length of the common offset."""
    object_error_m: float | None
    """Horizontal error of the task's object, less the common offset; None if it is missing."""
    seconds: float
    """Time of planning and the three executions [s]."""
    plan: TaskPlan | None = None
    """The plan, if there is one."""


def planned_there(
    task: ManipulationTask, reconstructed: SceneSpec, plan: TaskPlan | str | None = None
) -> PlannedThere:
    """Plan a task in a reconstruction and execute the plan; failures do not raise.

    The median offset of all objects other than supports comes from the response's camera, and a
    robot is calibrated to its camera, so the plan is moved back by it. For two objects this is
    their mean, which removes half of their relative error.

    Args:
        task: what is to be done.
        reconstructed: a scene of the same objects, moved to where the task's scene is. Objects may
            be missing, and the table shares the shift.
        plan: a plan made there, such as a model's; by default the reference planner makes it.
    """
    began = time.perf_counter()
    present, absent = _matched(task, reconstructed)
    shift, error = common_offset(task, reconstructed), None
    if task.object in present:
        (offset,) = offsets(reconstructed, task.scene, [task.object])
        error = float(np.linalg.norm(offset - shift))
    plan = _planned(task, reconstructed) if plan is None else plan
    if isinstance(plan, TaskPlan):
        back = (-float(shift[0]), -float(shift[1]), 0.0)
        on_truth = execute(task.scene, plan.shifted(back), task.predicate)
        unaligned = execute(task.scene, plan, task.predicate)
        in_scene = _carried_out(task, reconstructed, plan)
    else:
        plan += f"; the scene has no {', '.join(absent)}" if absent else ""
        on_truth = in_scene = unaligned = failed(f"no plan: {plan}")
    return PlannedThere(
        on_truth,
        in_scene,
        unaligned,
        float(np.linalg.norm(shift)),
        error,
        time.perf_counter() - began,
        plan if isinstance(plan, TaskPlan) else None,
    )


def common_offset(task: ManipulationTask, reconstructed: SceneSpec) -> NDArray:
    """Return the median horizontal offset of the objects from the ground truth [2] m."""
    present, _ = _matched(task, reconstructed)
    if not present:
        return np.zeros(2)
    return np.median(offsets(reconstructed, task.scene, present), axis=0)


def _matched(task: ManipulationTask, reconstructed: SceneSpec) -> tuple[list[str], list[str]]:
    """Return the names of the task's objects that a reconstruction has, and of those it lacks."""
    known = {item.name for item in reconstructed.objects}
    names = [item.name for item in task.scene.objects if not item.environment]
    return [n for n in names if n in known], [n for n in names if n not in known]


def _planned(task: ManipulationTask, reconstructed: SceneSpec) -> TaskPlan | str:
    """Return the plan, or the reason why there is none."""
    try:
        return task.plan_in(reconstructed)
    except Exception as error:  # Whatever a reconstruction lacks, there is no plan for it.
        return described(error)


def _carried_out(task: ManipulationTask, reconstructed: SceneSpec, plan: TaskPlan) -> Outcome:
    try:
        condition: Predicate = task.predicate_in(reconstructed)
        return execute(reconstructed, plan, condition)
    except Exception as error:  # Such as an object that the predicate names and the scene lacks.
        return failed(f"not carried out: {described(error)}")


def failed(reason: str) -> Outcome:
    """Return the outcome of a plan that was not executed."""
    return Outcome(False, reason, 0.0, 0.0)


def described(error: Exception) -> str:
    """Return an exception as one line."""
    lines = str(error).strip().splitlines()
    return ": ".join([type(error).__name__, *(line.strip() for line in lines[:3])])


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
    draws: int = 0
    """Number of draws about the result that are kept, in which plans are executed."""
    predicted: float | None = None
    """Share of the draws in which the plan of the result succeeds."""
    on_truths: float | None = None
    """Share of draws of the ground truth's physics in which it does."""
    chosen_predicted: float | None = None
    """Share of the draws in which that plan succeeds which succeeds in the most."""
    chosen_on_truth: bool | None = None
    """True if this plan solves the task in the ground truth."""

    @property
    def subject(self) -> str:
        """Name of the task."""
        return self.task

    @property
    def summary(self) -> str:
        """Line of the log."""
        done = "done" if self.on_truth else f"not done ({self.reason})"
        return f"{self.task} start {self.start} {self.label}: {done}, {self.seconds:.1f} s"


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
        try:
            for method, result in job.outcomes(tuple(remaining), initial, photo.scene):
                done = row(method, (photo, initial.scene, result))
                remaining.remove(method)
                yield done
        except Exception as error:
            yield row(remaining.pop(0), f"no result: {described(error)}")


def _row(
    job: MethodJob,
    task: ManipulationTask,
    errors: NoiseLog,
    method: str,
    outcome: tuple[TaskPhoto, SceneSpec, MethodResult] | str,
) -> SuccessRow:
    valid, missed, seconds, rollouts = False, 0, 0.0, 0
    draws, sampled = [], None
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
        if job.settings.samples and method != TRUTH:
            drawn = sample(result.scene, job.settings.samples, seed=job.settings.seed)
            draws = [photo.back(drawn.scene(int(k))) for k in drawn.kept]
            truths = []
            if there.plan is not None:
                varied = truth_samples(task.name, job.settings.samples, job.settings.seed)
                truths = [varied.scene(int(k)) for k in varied.kept]
            sampled = sampled_plans(
                task, scene, there.plan, draws, truths, common_offset(task, scene)
            )
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
        draws=len(draws),
        predicted=None if sampled is None else sampled.predicted,
        on_truths=None if sampled is None else sampled.on_truths,
        chosen_predicted=None if sampled is None else sampled.chosen_predicted,
        chosen_on_truth=None if sampled is None else sampled.chosen_on_truth.success,
        rollouts=rollouts,
    )


def _object_names(scene: SceneSpec) -> set[str]:
    return {item.name for item in scene.objects if not item.environment}

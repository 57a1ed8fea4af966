"""Tasks planned in a reconstruction, and executed there and in the ground truth."""

import time
from dataclasses import dataclass

import numpy as np

from neoworld_mjx.spec import SceneSpec

from ..methods.layout_errors import offsets
from .execution import Outcome, execute
from .plan_format import TaskPlan
from .predicates import Predicate
from .task import ManipulationTask


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
    reconstructed_names = {item.name for item in reconstructed.objects}
    names = [item.name for item in task.scene.objects if not item.environment]
    present = [name for name in names if name in reconstructed_names]
    offs = offsets(reconstructed, task.scene, present)
    shift = np.median(offs, axis=0) if present else np.zeros(2)
    error = None
    if task.object in present:
        error = float(np.linalg.norm(offs[present.index(task.object)] - shift))
    plan = _planned(task, reconstructed) if plan is None else plan
    if isinstance(plan, TaskPlan):
        back = (-float(shift[0]), -float(shift[1]), 0.0)
        on_truth = execute(task.scene, plan.shifted(back), task.predicate)
        unaligned = execute(task.scene, plan, task.predicate)
        in_scene = _carried_out(task, reconstructed, plan)
    else:
        missing = [name for name in names if name not in reconstructed_names]
        plan += f"; the scene has no {', '.join(missing)}" if missing else ""
        on_truth = in_scene = unaligned = failed(f"no plan: {plan}")
    return PlannedThere(
        on_truth,
        in_scene,
        unaligned,
        float(np.linalg.norm(shift)),
        error,
        time.perf_counter() - began,
    )


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

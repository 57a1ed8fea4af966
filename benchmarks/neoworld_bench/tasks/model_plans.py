"""Plans of a model in scenes that it sees, executed there and in the ground truth.

As in Section 4.4 of the paper, the outcome of a plan that fails refines the layout, and the same
plan is executed again in the refined layout and in the ground truth.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from neoworld_mjx.mllm import Panel, ask_or_record
from neoworld_mjx.spec import SceneSpec
from neoworld_mjx.sweeps.intervals import ratio_interval

from ..fidelity.rendered_scenes import photograph
from ..methods.method_runs import MethodJob, RunSettings
from ..methods.scene_methods import check_methods
from ..noise.parse_noise import NoiseLog
from ..rows import Row
from .outcome_feedback import refine_by_outcome
from .plan_requests import plan_request
from .reconstructed_plans import described, planned_there
from .success_runs import TRUTH
from .task import ManipulationTask
from .task_photo import TaskPhoto, photographed_task

SHARES = ("on_truth", "in_scene", "refined_on_truth", "refined_in_scene")
"""Shares of successful plans."""


class PlanRow(Row):
    """Result of one task planned by a model in one scene."""

    task: str
    kind: str
    method: str
    """Method that reconstructed the scene, or TRUTH."""
    start: int
    """Number of the initial scene."""
    planned: bool
    """False without a plan; the row then counts as a failure."""
    in_scene: bool = False
    """True if the plan succeeds in the scene for which it was made."""
    on_truth: bool = False
    """True if it succeeds in the ground truth, without the offset that all objects share: task
    success."""
    refined_in_scene: bool = False
    """The same as `in_scene` after the layout was refined by the outcome of a plan that failed."""
    refined_on_truth: bool = False
    executions: int = 0
    """Number of executions of the refinement."""
    reason: str
    """Reason of failure in the ground truth; empty on success."""


def plan_rows(
    models: Panel,
    task: ManipulationTask,
    *,
    methods: Sequence[str],
    starts: int,
    settings: RunSettings,
) -> Iterator[PlanRow]:
    """Request a plan of a task in each scene, and execute it there and in the ground truth.

    Args:
        models: provides the reasoner.
        task: the task.
        methods: methods that reconstruct the scenes, and TRUTH for the ground truth.
        starts: number of initial scenes of each method.
        settings: of the methods; the seed is also that of the refinement.
    """
    check_methods(methods, [TRUTH])
    photo = photographed_task(task.scene)
    for method in methods:
        for start in range(1 if method == TRUTH else starts):
            about = {"task": task.name, "kind": task.kind, "method": method, "start": start}
            failed = partial(PlanRow, **about, planned=False)
            try:
                scene = scene_of_method(task, photo, method, start, settings)
                condition = task.predicate_in(scene)
            except Exception as error:  # An error of one scene must not end the run of all others.
                yield failed(reason=f"no scene to plan in: {described(error)}")
                continue
            fallbacks: list[tuple[str, str]] = []
            request = plan_request(task, scene, photo)
            stage = f"{request.name} was not answered"
            answer = models.run(ask_or_record(models, request, stage, fallbacks))
            if answer is None:
                yield failed(reason=f"no plan: {fallbacks[0][1] if fallbacks else 'none given'}")
                continue
            first = again = planned_there(task, scene, answer.plan)
            executions = 0
            if not first.in_scene.success:
                refined = refine_by_outcome(scene, answer.plan, condition, seed=settings.seed)
                again = planned_there(task, refined.scene, answer.plan)
                executions = refined.executions
            yield PlanRow(
                **about,
                planned=True,
                in_scene=first.in_scene.success,
                on_truth=first.on_truth.success,
                refined_in_scene=again.in_scene.success,
                refined_on_truth=again.on_truth.success,
                executions=executions,
                reason=first.on_truth.reason,
            )


def scene_of_method(
    task: ManipulationTask, photo: TaskPhoto, method: str, start: int, settings: RunSettings
) -> SceneSpec:
    """Return the scene that a method reconstructs from a noisy response, at the task's place."""
    if method == TRUTH:
        return task.scene
    job = MethodJob(task.name, start, (method,), settings, threads=1, fingerprint="")
    initial = job.initial(photo.scene, f"task/{task.name}", NoiseLog())
    outcomes = job.outcomes((method,), initial, lambda: photograph(photo.scene), warm=False)
    return photo.back(dict(outcomes)[method].scene)


def plan_figures(rows: Sequence[PlanRow]) -> dict[str, Any]:
    """Return the shares of successful plans by method, with intervals clustered by task."""
    figures = {}
    for method in dict.fromkeys(row.method for row in rows):
        method_rows = [row for row in rows if row.method == method]
        unplanned = sum(not row.planned for row in method_rows)
        figures[method] = {"n": len(method_rows), "no_plan": unplanned}
        for name in SHARES:
            parts = [(row.task, float(getattr(row, name)), 1.0) for row in method_rows]
            share, low, high = ratio_interval(parts, share=True)
            figures[method] |= {f"success_{name}": share, f"success_{name}_interval": [low, high]}
    return {"n": len(rows), "tasks": len({row.task for row in rows}), "methods": figures}

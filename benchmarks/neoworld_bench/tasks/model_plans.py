"""Plans of a model in scenes that it sees, carried out there and in the ground truth.

With feedback, each method has a second row: the layout is refined by the outcome of the plan, as in
Section 4.4 of the paper, and the same plan is carried out in the refined layout and in the truth.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from neoworld_mjx.mllm import Panel
from neoworld_mjx.sweeps.intervals import ratio_interval

from ..methods.method_runs import RunSettings
from ..rows import Row
from .outcome_feedback import refine_by_outcome
from .plan_asking import ask_for_plan
from .planned_scenes import PlannedScene, Sees, reconstructed_scene, true_scene
from .reconstructed_plans import described, planned_there
from .task import ManipulationTask

FEEDBACK = "+feedback"
"""Ending of a method's name in rows after the refinement by the outcome."""


class PlanRow(Row):
    """Result of one task planned by a model in one scene."""

    task: str
    kind: str
    method: str
    """Origin of the scene that the model saw: a method, truth or displaced; with FEEDBACK after the
    refinement of the layout."""
    start: int
    plans: int
    """Number of plans; 0 if there is none, and the row counts as a failure."""
    executions: int
    """Number of executions of the refinement."""
    in_scene: bool
    """True if the best plan succeeds in the scene for which it was made."""
    on_truth: bool
    """True if it succeeds in the ground truth, without the offset that all objects share: task
    success."""
    reason: str
    """Reason of failure in the ground truth; empty on success."""
    scene_reason: str
    """Reason of failure in the scene."""


def plan_rows(
    models: Panel,
    tasks: Sequence[ManipulationTask],
    *,
    rounds: int,
    offset_m: float,
    feedback: bool,
    seed: int,
    sees: Sees = "both",
    methods: Sequence[str] = (),
    starts: int = 1,
    settings: RunSettings | None = None,
) -> Iterator[PlanRow]:
    """Request a plan of each task in each scene, and execute it there and in the ground truth.

    Args:
        models: provides the reasoner.
        tasks: the tasks.
        rounds: most revisions of a plan by its outcome in the scene.
        offset_m: displacement of the objects of the condition, without methods [m].
        feedback: True to refine the layout by the outcome of a plan that fails in it.
        seed: of displacements and refinement.
        sees: what the model sees of a scene.
        methods: methods that reconstruct the scenes; none for the true or the displaced scene.
        starts: number of initial scenes of each task and method.
        settings: of the methods.
    """
    for task in tasks:
        makers = {
            (method, start): partial(reconstructed_scene, task, method, start, settings, sees)
            for method in methods
            for start in range(starts)
            if settings is not None
        }
        rows = partial(scene_rows, models, task, rounds=rounds, feedback=feedback, seed=seed)
        if not methods:
            yield from rows(true_scene(task, offset_m, seed, sees))
        for (method, start), make in makers.items():
            try:
                scene = make()
            except Exception as error:  # An error of one scene must not end the run of all others.
                reason = f"no layout: {described(error)}"
                for name in (method, method + FEEDBACK)[: 1 + feedback]:
                    yield _without_plan(task, name, start, reason)
                continue
            yield from rows(scene)


def scene_rows(
    models: Panel,
    task: ManipulationTask,
    planned: PlannedScene,
    *,
    rounds: int,
    feedback: bool,
    seed: int,
) -> Iterator[PlanRow]:
    """Request a plan of a task in one scene; see `plan_rows`."""
    names = (planned.method, planned.method + FEEDBACK)[: 1 + feedback]
    try:
        condition = task.predicate_in(planned.scene)
    except Exception as error:  # Such as an object that the predicate names and the scene lacks.
        for name in names:
            yield _without_plan(task, name, planned.start, f"no plan: {described(error)}")
        return
    attempts = models.run(ask_for_plan(models, task, planned, condition, rounds=rounds))
    best = attempts.best
    if best is None:
        reason = attempts.fallbacks[0][1] if attempts.fallbacks else "the model gave none"
        for name in names:
            yield _without_plan(task, name, planned.start, f"no plan: {reason}")
        return
    scene, executions = planned.scene, 0
    for name in names:
        if name != planned.method and not best.outcome.success:
            refined = refine_by_outcome(scene, best.plan, condition, seed=seed)
            scene, executions = refined.scene, refined.executions
        outcome = planned_there(task, scene, best.plan)
        yield PlanRow(
            task=task.name,
            kind=task.kind,
            method=name,
            start=planned.start,
            plans=len(attempts.attempts),
            executions=executions,
            in_scene=outcome.in_scene.success,
            on_truth=outcome.on_truth.success,
            reason=outcome.on_truth.reason,
            scene_reason=outcome.in_scene.reason,
        )


def _without_plan(task: ManipulationTask, method: str, start: int, reason: str) -> PlanRow:
    return PlanRow(
        task=task.name,
        kind=task.kind,
        method=method,
        start=start,
        plans=0,
        executions=0,
        in_scene=False,
        on_truth=False,
        reason=reason,
        scene_reason=reason,
    )


def plan_figures(rows: Sequence[PlanRow]) -> dict[str, Any]:
    """Return both shares of successful plans by method, with intervals clustered by task."""
    figures = {}
    for method in dict.fromkeys(row.method for row in rows):
        method_rows = [row for row in rows if row.method == method]
        figures[method] = {
            "n": len(method_rows),
            "no_plan": sum(row.plans == 0 for row in method_rows),
        }
        for name, of in (("success_on_truth", "on_truth"), ("success_in_scene", "in_scene")):
            share, low, high = ratio_interval(
                [(row.task, float(getattr(row, of)), 1.0) for row in method_rows], share=True
            )
            figures[method] |= {name: share, f"{name}_interval": [low, high]}
    return {"tasks": len({row.task for row in rows}), "methods": figures}

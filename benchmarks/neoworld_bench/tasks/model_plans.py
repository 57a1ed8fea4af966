"""Plans of a model in displaced scenes, with and without feedback."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from neoworld_mjx.mllm import Panel
from neoworld_mjx.spec import SceneSpec

from ..rows import Row
from .execution import execute
from .outcome_feedback import refine_by_outcome
from .plan_asking import ask_for_plan, named_objects
from .task import ManipulationTask


class PlanRow(Row):
    """Result of one task planned by a model."""

    task: str
    kind: str
    plans: int
    """Number of plans."""
    in_scene: bool
    """True if one of them succeeds in the scene that the model saw."""
    after_feedback: bool
    """True if the best plan succeeds there after refinement by its outcome."""
    executions: int
    """Number of executions of the refinement."""
    on_truth: bool
    """True if the best plan succeeds in the true scene."""
    reason: str


def displaced_layout(task: ManipulationTask, offset_m: float, seed: int) -> SceneSpec:
    """Return a task's scene with the objects of its predicate displaced in random directions.

    Args:
        task: the task.
        offset_m: distance [m]; 0 is the true scene.
        seed: of the directions.
    """
    random = np.random.default_rng([seed, *task.name.encode()])
    named = named_objects(task.predicate)
    objects = []
    for item in task.scene.objects:
        angle = float(random.uniform(0, 2 * np.pi))
        if item.name in named and not item.environment and offset_m:
            x, y = item.xy
            xy = (x + offset_m * float(np.cos(angle)), y + offset_m * float(np.sin(angle)))
            item = item.model_copy(update={"xy": xy})
        objects.append(item)
    return task.scene.model_copy(update={"objects": tuple(objects)})


def plan_rows(
    models: Panel,
    tasks: Sequence[ManipulationTask],
    *,
    rounds: int,
    offset_m: float,
    feedback: bool,
    seed: int,
) -> Iterator[PlanRow]:
    """Request a plan of each task, and execute it."""
    for task in tasks:
        scene = displaced_layout(task, offset_m, seed)
        asked = models.run(ask_for_plan(models, task, scene, rounds=rounds))
        best = asked.best
        if best is None:
            reason = asked.fallbacks[0][1] if asked.fallbacks else "no plan"
            yield PlanRow(
                task=task.name,
                kind=task.kind,
                plans=0,
                in_scene=False,
                after_feedback=False,
                executions=0,
                on_truth=False,
                reason=reason,
            )
            continue
        refined, executions = best.outcome, 0
        if feedback and not refined.success:
            result = refine_by_outcome(scene, best.plan, task.predicate, seed=seed)
            refined, executions = result.outcome, result.executions
        truth = execute(task.scene, best.plan, task.predicate)
        yield PlanRow(
            task=task.name,
            kind=task.kind,
            plans=len(asked.attempts),
            in_scene=best.outcome.success,
            after_feedback=refined.success,
            executions=executions,
            on_truth=truth.success,
            reason=refined.reason,
        )


def plan_figures(rows: Sequence[PlanRow]) -> dict[str, Any]:
    """Return the numbers of successful plans."""
    return {
        "tasks": len(rows),
        "in_scene": sum(row.in_scene for row in rows),
        "after_feedback": sum(row.after_feedback for row in rows),
        "on_truth": sum(row.on_truth for row in rows),
    }

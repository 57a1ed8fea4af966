"""Plans requested from a model, executed, and revised with the outcome (Section 4.4)."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from neoworld_mjx.mllm import Panel, Picture, Request, ask_or_record, package_text, revise
from neoworld_mjx.spec import SceneSpec, bounds, joint_position, link_poses, world_poses
from neoworld_mjx.spec.kinematics import welded
from neoworld_mjx.spec.pose import rotate

from .execution import Outcome, execute
from .plan_format import TaskPlan
from .planned_scenes import PlannedScene
from .predicates import Predicate
from .task import ManipulationTask

MOST_JOINTS = 12
"""Maximum number of listed joints of an object."""


class PlannedTask(BaseModel):
    """A model's answer: the reasons first, so that the plan follows from them."""

    model_config = ConfigDict(extra="forbid")

    reasoning: Annotated[str, Field(max_length=2000)] = ""
    plan: TaskPlan


@dataclass(frozen=True)
class PlanAttempt:
    """A plan with its outcome."""

    plan: TaskPlan
    outcome: Outcome


@dataclass(frozen=True)
class AskedPlan:
    """All plans of a model for a task."""

    attempts: tuple[PlanAttempt, ...]
    """Attempts in order; empty if there is no plan."""
    fallbacks: tuple[tuple[str, str], ...]
    """Failed requests, with reasons."""

    @property
    def best(self) -> PlanAttempt | None:
        """First attempt that succeeds, otherwise the one with the most progress."""
        return max(
            self.attempts, key=lambda a: (a.outcome.success, a.outcome.progress), default=None
        )


def plan_request(
    task: ManipulationTask, planned: PlannedScene, earlier: Sequence[PlanAttempt] = ()
) -> Request[PlannedTask]:
    """Return the request for a plan.

    Args:
        task: gives the instruction; its truth is not told.
        planned: the scene as it is known, such as a reconstruction.
        earlier: plans that failed, which are told with their outcomes.
    """
    parts, pictures = [], []
    if planned.picture is not None:
        pictures = [Picture.of("scene", planned.picture)]
        parts.append(planned.view_in_words)
    if planned.in_numbers:
        parts.append(f"The scene:\n{scene_in_numbers(planned.scene)}")
    else:
        parts.append("Its objects: " + ", ".join(item.name for item in planned.scene.objects))
    parts.append(f"The instruction: {task.instruction}")
    prompt = "\n\n".join(parts)
    for number, attempt in enumerate(earlier, start=1):
        outcome = attempt.outcome
        prompt += (
            f"\n\nPlan {number} was {attempt.plan.model_dump_json()}\nIt failed: {outcome.reason}. "
            f"The tool stayed up to {100 * outcome.lag_m:.0f} cm behind the plan."
        )
    if earlier:
        prompt += "\n\nGive a better plan."
    system = package_text(__package__, "planner").removesuffix("\n")
    return Request("reasoner", f"plan:{task.name}", system, prompt, PlannedTask, pictures)


def scene_in_numbers(scene: SceneSpec) -> str:
    """Return each object's pose and box in the world, and its joints, as text."""
    lines = []
    poses = world_poses(scene)
    for item in scene.objects:
        object_pose = poses[item.name]
        low, high = bounds(item.spec, item.joint_state)
        edges, middle = high - low, object_pose.apply((low + high) / 2)
        axes = ", ".join(
            f"{name} {_vector(rotate(object_pose.quat, row))}" for name, row in _axes()
        )
        support = f", carried by {item.parent}" if item.parent else ""
        immobile = ", cannot move" if item.static else ""
        lines.append(
            f"- {item.name} ({item.spec.label or item.spec.name}{support}{immobile}): box of edges "
            f"{_vector(edges)} along its axes {axes}; middle of the box {_vector(middle)}, origin "
            f"{_vector(object_pose.pos)}"
        )
        part_poses = link_poses(item.spec, item.joint_state)
        group = welded(item.spec)
        for joint in [j for j in item.spec.joints if j.type != "fixed"][:MOST_JOINTS]:
            value = joint_position(item.spec, joint, item.joint_state)
            base = object_pose.then(part_poses[joint.parent])
            now = "a ball" if isinstance(value, tuple) else f"now {value:.2f}"
            limits = (
                f", {joint.lower:.2f} to {joint.upper:.2f}" if joint.upper > joint.lower else ""
            )
            parts = [
                part.name for part in item.spec.parts if group[part.name] == group[joint.child]
            ]
            lines.append(
                f"  - joint {joint.name} ({joint.type}) of {' and '.join(parts)}: {now}{limits}; "
                f"axis {_vector(rotate(base.quat, joint.axis))} through "
                f"{_vector(base.apply(np.array(joint.pos)))}"
            )
    return "\n".join(lines)


async def ask_for_plan(
    models: Panel,
    task: ManipulationTask,
    planned: PlannedScene,
    condition: Predicate,
    *,
    rounds: int = 2,
) -> AskedPlan:
    """Request a plan, execute it, and request revisions with the outcome while it fails.

    Args:
        models: provides the reasoner.
        task: what is to be done.
        seen: where the plans are carried out, such as a reconstruction.
        condition: what success is there.
        rounds: most revisions.

    Raises:
        BudgetError: the cost cap is reached.
        MissingResponseError: a tape lacks the response.
    """
    fallbacks: list[tuple[str, str]] = []

    async def attempt(earlier: Sequence[PlanAttempt]) -> PlanAttempt | None:
        request = plan_request(task, planned, earlier)
        stage = f"{request.name} was not answered"
        answer = await ask_or_record(models, request, stage, fallbacks)
        if answer is None:
            return None
        outcome = await asyncio.to_thread(execute, planned.scene, answer.plan, condition)
        return PlanAttempt(answer.plan, outcome)

    first = await attempt(())
    if first is None:
        return AskedPlan((), tuple(fallbacks))
    attempts = await revise(
        first, rounds=rounds, accept=lambda a: a.outcome.success, next_attempt=attempt
    )
    return AskedPlan(tuple(attempts), tuple(fallbacks))


def _axes() -> list[tuple[str, tuple[float, float, float]]]:
    return [("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0)), ("z", (0.0, 0.0, 1.0))]


def _vector(values: Sequence[float] | np.ndarray) -> str:
    return "(" + ", ".join(f"{float(v) + 0.0:.3f}" for v in np.round(values, 3)) + ")"

"""Plans of a model in the scenes that it sees, executed there and in the ground truth.

A model gets a scene as a picture and numbers, and answers with a plan (Section 4.4 of the
paper). The paper says of a plan that fails: "We use this execution outcome as a feedback signal to
iteratively refine the scene layout until the placement succeeds"; it does not state the method.
Here the Cross-Entropy Method of the scene refinement moves the objects that the task names. A
candidate's reward is the progress of the plan executed in it, plus 1 on success, less the prior.
The resulting layout may differ from the ground truth, in which the same plan is executed, too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt8
from pydantic import BaseModel, ConfigDict, Field

from neoworld_mjx.config import CEMOptions
from neoworld_mjx.environments.predicates import Predicate, named_objects
from neoworld_mjx.mllm import Panel, Picture, Request, ask_or_record, package_text
from neoworld_mjx.mllm.panel import run_coroutine
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.render import View, render
from neoworld_mjx.search.cem import open_cem
from neoworld_mjx.spec import SceneSpec, bounds, joint_position, link_poses, world_poses
from neoworld_mjx.spec.kinematics import welded
from neoworld_mjx.spec.pose import rotate
from neoworld_mjx.sweeps.intervals import ratio_interval

from ..methods.method_runs import MethodJob, RunSettings
from ..methods.scene_methods import check_methods
from ..noise.parse_noise import NoiseLog
from ..rows import Row
from .execution import Outcome, execute
from .plan_format import TaskPlan
from .success_runs import TRUTH, described, planned_there
from .task import ManipulationTask
from .task_scenes import TaskPhoto, photographed_task

PRIOR_WEIGHT = 0.02
"""Loss of a layout one standard deviation away; progress is worth up to 1."""


@dataclass(frozen=True)
class FeedbackResult:
    """Layout with the highest progress of a plan."""

    scene: SceneSpec
    outcome: Outcome
    executions: int


def refine_by_outcome(
    scene: SceneSpec,
    plan: TaskPlan,
    predicate: Predicate,
    *,
    options: CEMOptions | None = None,
    seed: int = 0,
) -> FeedbackResult:
    """Move the objects that a task names until a plan succeeds.

    Args:
        scene: the scene in which the plan fails.
        plan: the plan, which stays.
        predicate: what success is; the objects that it names are moved, but for the environment.
        options: of the Cross-Entropy Method; by default 24 candidates and at most 6 iterations.
        seed: of the draws.

    Returns:
        The first candidate that succeeds, else the best.
    """
    o = options or CEMOptions(population=24, iterations=6, elite_ratio=0.2)
    model = compile_scene(scene)
    moves = np.array([name in named_objects(predicate) for name in model.names])
    fixed = replace(model, optimised=jnp.asarray(model.optimised) & moves)
    cem = open_cem(fixed, o)
    state, key = cem.init(), jax.random.key(seed)
    best: tuple[float, SceneSpec, Outcome] | None = None
    executions = 0
    for _ in range(o.iterations):
        key, now = jax.random.split(key)
        layouts = cem.ask(now, state, o.population)
        poses = model.place(layouts)
        prior = _prior(layouts, cem.sigma)
        rewards = []
        for k in range(o.population):
            candidate = model.apply(layouts, k, poses)
            outcome = execute(candidate, plan, predicate)
            executions += 1
            reward = outcome.progress + outcome.success - PRIOR_WEIGHT * float(prior[k])
            rewards.append(reward)
            if best is None or reward > best[0]:
                best = (reward, candidate, outcome)
            if outcome.success:
                return FeedbackResult(candidate, outcome, executions)
        state = cem.tell(state, layouts, jnp.asarray(rewards))
    assert best is not None
    return FeedbackResult(best[1], best[2], executions)


def _prior(layouts: Layout, sigma: Layout) -> np.ndarray:
    """Return the mean squared displacement of the moved objects in standard deviations [pop]."""
    total, count = 0.0, 0
    for leaf, spread in zip(jax.tree.leaves(layouts), jax.tree.leaves(sigma), strict=True):
        moved = np.asarray(spread)[0] > 0
        ratio = np.asarray(leaf)[:, moved] / np.asarray(spread)[:, moved]
        total = total + np.sum(ratio.reshape(len(ratio), -1) ** 2, axis=1)
        count += int(np.sum(moved))
    return np.asarray(total) / max(count, 1)


MOST_JOINTS = 12
"""Maximum number of listed joints of an object."""


class PlannedTask(BaseModel):
    """A model's answer: the reasons first, so that the plan follows from them."""

    model_config = ConfigDict(extra="forbid")

    reasoning: Annotated[str, Field(max_length=2000)] = ""
    plan: TaskPlan


def plan_request(
    task: ManipulationTask, scene: SceneSpec, photo: TaskPhoto
) -> Request[PlannedTask]:
    """Return the request for a plan, with a picture of the scene and its numbers.

    Args:
        task: gives the instruction; its ground truth is not part of the request.
        scene: the scene to plan in, such as a reconstruction.
        photo: photograph of the task, whose camera the picture is rendered through.
    """
    picture, view = _pictured(scene, photo)
    parts = [
        _view_in_words(view),
        f"The scene:\n{scene_in_numbers(scene)}",
        f"The instruction: {task.instruction}",
    ]
    system = package_text(__package__, "planner").removesuffix("\n")
    pictures = [Picture("scene", picture)]
    prompt = "\n\n".join(parts)
    return Request("reasoner", f"plan:{task.name}", system, prompt, PlannedTask, pictures)


def _pictured(scene: SceneSpec, photo: TaskPhoto) -> tuple[UInt8[np.ndarray, "row column 3"], View]:
    """Return a picture of a scene, and its camera in the world of the scene."""
    assert photo.scene.camera is not None
    view, to_world = View.of(photo.scene.camera), photo.scene_transform.inverse()
    view = view._replace(eye=to_world.apply(view.eye), axes=rotate(to_world.quat, view.axes.T).T)
    return render(scene, view).color, view


def _view_in_words(view: View) -> str:
    right, down, ahead = view.axes.T
    fovx = 2 * np.arctan(np.tan(view.fovy / 2) * view.width / view.height)
    named = (("position", view.eye), ("right", right), ("down", down), ("ahead", ahead))
    words = ", ".join(f"{name} {_vector(value)}" for name, value in named)
    return (
        f"The picture 'scene' shows it through a camera, in the world's axes: {words}; fields "
        f"of view {np.degrees(fovx):.1f} degrees across and {np.degrees(view.fovy):.1f} upright."
    )


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


def _axes() -> list[tuple[str, tuple[float, float, float]]]:
    return [("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0)), ("z", (0.0, 0.0, 1.0))]


def _vector(values: Sequence[float] | np.ndarray) -> str:
    return "(" + ", ".join(f"{float(v) + 0.0:.3f}" for v in np.round(values, 3)) + ")"


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
            answer = run_coroutine(ask_or_record(models, request, stage, fallbacks))
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
    job = MethodJob(task.name, start, (method,), settings, 1, *settings.evidence)
    initial = job.initial(photo.scene, f"task/{task.name}", NoiseLog())
    outcomes = job.outcomes((method,), initial, photo.scene)
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

"""Manipulation tasks as tasks of policies: the point of contact, the gripper's start, and a script.

All of it comes from the reference plan in the same scene, so a policy that is trained in a
reconstruction knows nothing of the ground truth.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.environments.arm import SceneState
from neoworld_mjx.environments.controlled_scene import controlled_scene
from neoworld_mjx.environments.policy_environment import Script
from neoworld_mjx.environments.predicates import JointBetween, Predicate
from neoworld_mjx.environments.randomization import Variants
from neoworld_mjx.environments.task import SceneTask, StateView, Task, WorkPoint
from neoworld_mjx.physics.gripper import PREFIX, Gripper
from neoworld_mjx.spec import SceneSpec, link_poses, world_poses

from .execution import CONTROL_S, plan_path
from .plan_format import TaskPlan
from .task import ManipulationTask
from .world import in_start_axes

AWAY_M = 0.06
"""Distance of the gripper's start behind that of the plan, against its approach [m]."""
START_M = (0.03, 0.03, 0.015)
"""Standard deviation of the gripper's start in training [m], because a robot's frame and the
reconstruction's differ by about as much."""
PACE = 1.5
"""Speed of the script, relative to the plan."""


def contact(plan: TaskPlan) -> tuple[NDArray, bool]:
    """Return where a plan first works on its object [3] m, and whether the gripper closes there.

    It is where the first move along the approach ends, if other moves follow, and otherwise the
    start.
    """
    start, first = np.array(plan.position), plan.moves[0]
    way, approach = np.array(first.displacement), np.array(plan.approach)
    ahead = np.linalg.norm(np.cross(way, approach)) < 1e-6 * np.linalg.norm(approach)
    if len(plan.moves) == 1 or not ahead or first.about is not None:
        return start, False
    return start + way, plan.moves[1].opening == 0 and first.opening > 0


def policy_task(task: ManipulationTask, scene: SceneSpec, plan: TaskPlan, goal: Predicate) -> Task:
    """Return a task for policies in a scene, from a plan there."""
    item = scene.object(task.object)
    part = item.spec.root
    if isinstance(goal, JointBetween):
        part = item.spec.joint(goal.joint).child
    at, closes = contact(plan)
    here = world_poses(scene)[item.name].then(link_poses(item.spec, item.joint_state)[part])
    x, y, z = here.inverse().apply(at).tolist()
    return Task(task.instruction, scene, goal, WorkPoint(item.name, part, (x, y, z), closes))


def gripper_at(plan: TaskPlan, by: NDArray) -> Gripper:
    """Return a gripper behind the start of a plan, displaced horizontally [2] m."""
    x, y, z = (np.array(plan.position) - AWAY_M * _ahead(plan) + (*by, 0.0)).tolist()
    w, i, j, k = plan.quat.tolist()
    return Gripper((x, y, z), (w, i, j, k), plan.opening)


def gripper_task(task: Task, gripper: Gripper) -> SceneTask:
    """Return a task with a flying gripper."""
    return task.on(controlled_scene(task.scene, gripper=gripper))


def with_start_noise(task: SceneTask, variants: Variants, seed: int) -> Variants:
    """Return variants in which the gripper starts elsewhere, by normal noise of `START_M`."""
    model = task.controlled.model
    noise = np.random.default_rng(seed).normal(0.0, START_M, (len(variants), 3))
    qpos, ctrl = variants.qpos.copy(), np.tile(task.controlled.initial_ctrl, (len(variants), 1))
    for k, axis in enumerate("xyz"):
        qpos[:, model.joint(f"{PREFIX}-{axis}").qposadr[0]] += noise[:, k]
        ctrl[:, model.actuator(f"{PREFIX}-{axis}").id] += noise[:, k]
    return replace(variants, qpos=qpos.astype(np.float32), ctrl=ctrl.astype(np.float32))


def plan_script(task: SceneTask, plan: TaskPlan, control_s: float) -> Script:
    """Return the plan as a script that follows where the object is.

    Args:
        task: the task with the gripper of `gripper_at`.
        plan: the plan in the task's scene.
        control_s: duration of an action [s].
    """
    back = AWAY_M * _ahead(plan)
    rows = [[*(share * back), 0.0, 0.0, 0.0, plan.opening] for share in np.linspace(0.2, 1.0, 5)]
    for displacement, orientation, opening in plan_path(plan)[
        :: round(PACE * control_s / CONTROL_S)
    ]:
        vector = np.zeros(3)
        mujoco.mju_quat2Vel(vector, orientation, 1.0)
        rows.append([*(displacement + back), *in_start_axes(plan, vector), opening])
    table, nominal = jnp.asarray(rows, jnp.float32), contact(plan)[0].astype(np.float32)

    def action(_: SceneState, first: SceneState, t: jax.Array) -> jax.Array:
        shift = StateView(task.controlled, first).point(task.task.point) - nominal
        return table[t].at[:3].add(shift)

    return Script(action, len(rows))


def _ahead(plan: TaskPlan) -> NDArray:
    return np.array(plan.approach) / np.linalg.norm(plan.approach)

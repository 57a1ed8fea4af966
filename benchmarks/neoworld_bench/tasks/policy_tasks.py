"""Manipulation tasks as tasks of policies: the point of contact, what performs them, and a script.

All of it comes from the reference plan in the same scene, so a policy that is trained in a
reconstruction knows nothing of the ground truth.
"""

from dataclasses import dataclass, replace

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
from neoworld_mjx.environments.reach import propose_mount
from neoworld_mjx.environments.robots import Mount
from neoworld_mjx.environments.scripted_motion import arm_script
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


@dataclass(frozen=True)
class Effector:
    """Effector of a task: a flying gripper, or a robot on its mount."""

    gripper: Gripper | None = None
    robot: str | None = None
    mount: Mount | None = None

    @classmethod
    def of(cls, task: Task, plan: TaskPlan, robot: str | None) -> "Effector":
        """Return a gripper behind the start of a plan, or a robot where it reaches the task.

        Raises:
            SpecError: the robot is not installed, or reaches the task from nowhere.
        """
        if robot is None:
            return cls(gripper_at(plan, np.zeros(2)))
        return cls(robot=robot, mount=propose_mount(task, robot))

    def moved(self, by: NDArray) -> "Effector":
        """Return the effector displaced horizontally [2] m."""
        base = self.gripper or self.mount
        assert base is not None
        x, y, z = base.pos
        moved = replace(base, pos=(x + float(by[0]), y + float(by[1]), z))
        return replace(self, gripper=moved) if self.gripper else replace(self, mount=moved)

    def on(self, task: Task) -> SceneTask:
        """Return a task that the effector performs; of a robot only hand and fingers collide."""
        return task.on(
            controlled_scene(
                task.scene, gripper=self.gripper, robot=self.robot, mount=self.mount, links=False
            )
        )

    def script(self, task: SceneTask, plan: TaskPlan, control_s: float) -> Script | None:
        """Return a motion along which episodes of training may start."""
        if self.robot is None or self.mount is None:
            return plan_script(task, plan, control_s)
        return arm_script(task, self.robot, self.mount)


def gripper_at(plan: TaskPlan, by: NDArray) -> Gripper:
    """Return a gripper behind the start of a plan, displaced horizontally [2] m."""
    x, y, z = (np.array(plan.position) - AWAY_M * _ahead(plan) + (*by, 0.0)).tolist()
    w, i, j, k = plan.quat.tolist()
    return Gripper((x, y, z), (w, i, j, k), plan.opening)


def with_start_noise(task: SceneTask, variants: Variants, seed: int) -> Variants:
    """Return variants in which the gripper or robot is elsewhere, by normal noise of `START_M`."""
    model = task.controlled.model
    noise = np.random.default_rng(seed).normal(0.0, START_M, (len(variants), 3))
    if (arm := task.controlled.arm) is not None:
        at = np.tile(model.body_pos, (len(variants), 1, 1)).astype(np.float32)
        at = variants.fields.get("body_pos", at).copy()
        at[:, arm.root] += noise
        return replace(variants, fields={**variants.fields, "body_pos": at})
    qpos, ctrl = variants.qpos.copy(), variants.ctrl.copy()
    for k, axis in enumerate("xyz"):
        qpos[:, model.joint(f"{PREFIX}-{axis}").qposadr[0]] += noise[:, k]
        ctrl[:, model.actuator(f"{PREFIX}-{axis}").id] += noise[:, k]
    return replace(variants, qpos=qpos, ctrl=ctrl)


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

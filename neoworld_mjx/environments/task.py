"""Tasks: an instruction, its success, its progress and its reward, in one scene.

A `Task` is data: names, a predicate and the point that the tool works on. `task.on(controlled)`
evaluates it on states of a `ControlledScene`, in NumPy or in JAX under `jit` and `vmap`.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError, choices
from ..export.link_frames import frames
from ..physics.mjcf import body_name
from ..spec import JointSpec, SceneObject, SceneSpec, bounds, joint_position, world_poses
from ..spec.pose import length, rotate
from .arm import SceneState, scene_state
from .controlled_scene import ControlledScene
from .predicates import (
    BACK,
    Every,
    JointBetween,
    Leaning,
    Located,
    Predicate,
    Reached,
    leaves,
)

CONTROL_S = 0.02
"""Duration of a control step, unless an environment has another [s]."""
HORIZON, PLACE_HORIZON = 250, 400
"""Control steps of an episode: 5 s, and 8 s where an object is carried and let go."""
REACH, GRASP, PROGRESS, SUCCESS, EFFORT = 0.2, 0.2, 0.6, 1.0, 0.005
"""Weights of the reward's terms."""
FAR_M, CLOSE_M = 0.3, 0.03
"""Distances over which the reward of reaching falls [m]."""
DEPTH_M = 0.03
"""Depth below the top of an object at which the tool works on it, if it is higher [m]."""
PUSH_M = 0.015
"""Distance from the side of an object at which a tool begins to push it [m]."""
HELD_M = 0.02
"""Margin of an object's box within which a closed gripper holds the object [m]."""


@dataclass(frozen=True)
class WorkPoint:
    """The point of an object that the tool works on, such as a handle."""

    object: str
    part: str
    pos: tuple[float, float, float]
    """In the object's frame with all joints at zero [m]."""
    grasp: bool = True
    """True if the gripper closes there."""


@dataclass(frozen=True)
class Task:
    """A task in a scene, as data."""

    instruction: str
    scene: SceneSpec
    """The scene in the initial state of the task."""
    goal: Predicate
    point: WorkPoint
    horizon: int = HORIZON
    """Control steps of an episode."""

    def on(self, controlled: ControlledScene) -> "SceneTask":
        """Return the task on the states of a scene with a robot or a gripper."""
        return SceneTask(self, controlled)


@dataclass(frozen=True)
class SceneTask:
    """A task on the states of a controlled scene; states are in NumPy or JAX, without a batch."""

    task: Task
    controlled: ControlledScene

    def success(self, state: SceneState) -> Any:
        """Return True if the goal holds."""
        return self.task.goal.holds(StateView(self.controlled, state))

    def progress(self, state: SceneState) -> Any:
        """Return the share of the initial distance to the goal that is done, from 0 to 1."""
        view = StateView(self.controlled, state)
        share = 1 - self.task.goal.distance(view) / self.initial_distance
        return view.xp.clip(share, 0.0, 1.0)

    @cached_property
    def initial_state(self) -> SceneState:
        """State of the scene itself, in NumPy."""
        return scene_state(self.controlled.initial_data())

    @cached_property
    def initial_distance(self) -> float:
        """Distance of the initial state from the goal, in the goal's unit."""
        state = self.initial_state
        start = float(self.task.goal.distance(StateView(self.controlled, state)))
        if start <= 0 and bool(self.success(state)):
            raise SpecError(f"task {self.task.instruction!r}: it is done from the start")
        return max(start, 1e-3)

    def reward(
        self, obs: Any, action: Any, state: SceneState, previous: SceneState | None = None
    ) -> Any:
        """Return the reward of a state, the same sum for all tasks.

        The tool reaches the point, the gripper closes there, the goal comes nearer, and holds. What
        serves to reach the goal counts as done when the goal is reached.

        Args:
            obs: observations, which this reward does not need.
            action: the action that led to the state, shape [action].
            state: the state.
            previous: the state before, which this reward does not need.
        """
        view = StateView(self.controlled, state)
        xp, point = view.xp, self.task.point
        apart = length(view.tool_position() - view.point(point), xp)
        reach = 0.5 * xp.exp(-apart / FAR_M) + 0.5 * xp.exp(-apart / CLOSE_M)
        progress, success = self.progress(state), self.success(state)
        done = xp.where(progress >= 1.0, 1.0, 0.0)
        grip = (1 - view.opening()) * xp.exp(-apart / CLOSE_M) if point.grasp else reach
        return (
            REACH * xp.maximum(reach, done)
            + GRASP * xp.maximum(grip, done)
            + PROGRESS * progress
            + SUCCESS * success
            - EFFORT * xp.mean(xp.asarray(action) ** 2)
        )


class StateView:
    """Reads a `SceneState` for predicates; see `predicates.StateReader`.

    A state has no contacts. Objects touch if their boxes do, and a gripper holds an object if its
    tool is inside the object's box and the fingers are not open.
    """

    def __init__(self, controlled: ControlledScene, state: SceneState) -> None:
        self.controlled, self.state = controlled, state
        self.xp = jnp if isinstance(state.qpos, jax.Array) else np

    def _item(self, name: str) -> SceneObject:
        return self.controlled.scene.spec.object(name)

    def pose(self, name: str, part: str | None = None) -> tuple[Any, Any]:
        """Return the pose of an object, or of a part, whose frame at rest is the object's."""
        item, state = self._item(name), self.state
        body = self.controlled.model.body(body_name(item, part or item.spec.root)).id
        pos, quat = state.xpos[body], state.xquat[body]
        anchors = [joint.pos for joint in item.spec.joints if joint.child == part]
        for anchor in anchors:
            pos = pos - rotate(quat, self.xp.asarray(anchor), self.xp)
        return pos, quat

    def point(self, point: WorkPoint) -> Any:
        """Return the position of a task's point [m]."""
        pos, quat = self.pose(point.object, point.part)
        return pos + rotate(quat, self.xp.asarray(point.pos), self.xp)

    def speed(self, name: str) -> tuple[Any, Any]:
        """Return the speeds of an object's root [m/s], [rad/s]; 0 if it is fixed."""
        body = self.controlled.model.body(name)
        if not int(body.jntnum[0]):
            return self.xp.zeros(()), self.xp.zeros(())
        dof = int(body.dofadr[0])
        velocity = self.state.qvel[dof : dof + 6]
        return length(velocity[:3], self.xp), length(velocity[3:], self.xp)

    def joint(self, name: str, joint: str, *, fraction: bool) -> tuple[Any, Any, bool]:
        """Return a joint's value, or share of its range, its rate, and whether it slides."""
        model = self.controlled.model
        j = model.joint(f"{name}-{joint}").id
        value = self.state.qpos[int(model.jnt_qposadr[j])]
        if fraction:
            low, high = model.jnt_range[j]
            value = (value - low) / (high - low)
        rate = self.xp.abs(self.state.qvel[int(model.jnt_dofadr[j])])
        return value, rate, bool(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE)

    def touches(self, name: str, other: str) -> Any:
        """Return True if the box of an object meets the other's, in the other's axes."""
        xp = self.xp
        (pos, quat), (base, turn) = self.pose(name), self.pose(other)
        middle, half = _box(self._item(name))
        middle_other, half_other = _box(self._item(other))
        center = rotate(quat, xp.asarray(middle), xp) + pos
        apart = xp.abs(rotate(turn * BACK, center - base, xp) - middle_other)
        return xp.all(apart <= np.linalg.norm(half) + half_other)

    def held(self, name: str) -> Any:
        """Return True if the tool is in an object's box and the fingers are not open."""
        controlled = self.controlled
        if controlled.effector is None:
            return self.xp.zeros((), bool)
        pos, quat = self.pose(name)
        middle, half = _box(self._item(name))
        local = rotate(quat * BACK, self.tool_position() - pos, self.xp) - middle
        inside = self.xp.all(self.xp.abs(local) <= half + HELD_M)
        return inside & (self.opening() < 0.9)

    def tool_position(self) -> Any:
        """Return the position of the tool [m]."""
        return self.controlled.tool(self.state, self.xp)[0]

    def opening(self) -> Any:
        """Return how far the fingers are open, from 0 to 1."""
        return self.xp.clip(self.controlled.opening(self.state, self.xp), 0.0, 1.0)


def _box(item: SceneObject) -> tuple[NDArray, NDArray]:
    """Return the middle and half edges of an object's box in its initial state [m]."""
    low, high = bounds(item.spec, item.joint_state)
    return (low + high) / 2, (high - low) / 2


# Makers


def movable_joints(scene: SceneSpec) -> list[tuple[SceneObject, JointSpec]]:
    """Return the joints that tasks may move, with their objects."""
    return [
        (item, joint)
        for item in scene.objects
        for joint in item.spec.joints
        if joint.type != "fixed" and joint.mimic is None
    ]


def _joint(scene: SceneSpec, name: str) -> tuple[SceneObject, JointSpec]:
    """Return the object and joint of a name: of the joint, of the part it moves, or of a handle."""
    found, shown = {}, []
    for item, joint in movable_joints(scene):
        shown.append(f"{item.name}-{joint.child}")
        for own in (joint.child, f"{joint.child}_handle", joint.name):
            found[f"{item.name}-{own}"] = item, joint
    if name not in found:
        raise SpecError(f"scene {scene.name}: joint: {choices(name, shown)}")
    return found[name]


def _handle(item: SceneObject, joint: JointSpec, *, grasp: bool = True) -> WorkPoint:
    handle = next(frame for frame in frames(item.spec) if frame.joint == joint.name)
    return WorkPoint(item.name, handle.part, handle.pos, grasp)


def _body_point(item: SceneObject, *, grasp: bool = True) -> WorkPoint:
    """Return the site "grasp" of an object, or the middle of its box; below the top if high."""
    sites = [site for site in item.spec.sites if site.name == "grasp" and grasp]
    (x, y, z), half = (values.tolist() for values in _box(item))
    at = sites[0].pos if sites else (x, y, z + max(0.0, half[2] - DEPTH_M))
    part = sites[0].part if sites else item.spec.root
    return WorkPoint(item.name, part, at, grasp)


def _with_joint(scene: SceneSpec, item: SceneObject, joint: str, value: float) -> SceneSpec:
    moved = item.model_copy(update={"joint_state": {**item.joint_state, joint: value}})
    objects = tuple(moved if other.name == item.name else other for other in scene.objects)
    return scene.model_copy(update={"objects": objects})


def reach(scene: SceneSpec, name: str) -> Task:
    """Move the tool to the handle of a joint, or to an object."""
    if any(item.name == name for item in scene.objects):
        point = _body_point(scene.object(name), grasp=False)
    else:
        point = _handle(*_joint(scene, name), grasp=False)
    goal = Reached(object=point.object, part=point.part, point=point.pos, source="own bound")
    return Task(f"reach {name}", scene, goal, point)


def open_joint(scene: SceneSpec, name: str, share: float = 0.8) -> Task:
    """Open a joint, named after the part that it moves, to at least a share of its range."""
    item, joint = _joint(scene, name)
    _check_range(item, joint, "open")
    goal = JointBetween(
        object=item.name,
        joint=joint.name,
        low=share,
        high=1.1,
        source="OpenCabinetDrawer-v1 of ManiSkill, with the share as given",
    )
    return Task(f"open {name}", scene, goal, _handle(item, joint))


def close_joint(scene: SceneSpec, name: str, share: float = 0.1, start: float = 0.8) -> Task:
    """Close a joint to at most a share of its range; it starts open if it is closed now."""
    item, joint = _joint(scene, name)
    _check_range(item, joint, "close")
    now = joint_position(item.spec, joint, item.joint_state)
    assert not isinstance(now, tuple)
    width = joint.upper - joint.lower
    if (now - joint.lower) / width <= share:
        scene = _with_joint(scene, item, joint.name, joint.lower + start * width)
    goal = JointBetween(
        object=item.name, joint=joint.name, low=-0.1, high=share, source="converse of opening"
    )
    return Task(f"close {name}", scene, goal, _handle(item, joint, grasp=False))


def press(scene: SceneSpec, name: str, share: float = 0.7) -> Task:
    """Press a button, a joint of a short range, by at least a share of its range."""
    return replace(
        open_joint(scene, name, share),
        instruction=f"press {name}",
        point=_handle(*_joint(scene, name), grasp=False),
    )


def turn(scene: SceneSpec, name: str, angle: float = math.pi / 3) -> Task:
    """Turn a joint by at least an angle [rad]."""
    item, joint = _joint(scene, name)
    now = joint_position(item.spec, joint, item.joint_state)
    if isinstance(now, tuple) or joint.type == "prismatic":
        raise SpecError(f"task turn: joint {name} is {joint.type}; open or push it")
    goal = JointBetween(
        object=item.name,
        joint=joint.name,
        low=now + angle,
        high=now + angle + 2 * math.pi,
        absolute=True,
        source="own bound",
    )
    return Task(f"turn {name}", scene, goal, _handle(item, joint))


def _check_range(item: SceneObject, joint: JointSpec, verb: str) -> None:
    if joint.type not in ("prismatic", "revolute"):
        raise SpecError(
            f"task {verb}: joint {item.name}-{joint.name} is {joint.type} and has no range; turn it"
        )


def _world(scene: SceneSpec) -> SceneObject:
    """Return an object that does not move, relative to whose frame objects are moved."""
    fixed = [item for item in scene.objects if item.environment]
    if not fixed:
        raise SpecError(f"scene {scene.name}: nothing in it is an environment")
    return fixed[0]


def _moved(scene: SceneSpec, name: str, by: tuple[float, float, float], **bounds_of: Any) -> Any:
    """Return the predicate that an object is displaced in the scene's axes [m]."""
    item, base = scene.object(name), _world(scene)
    poses = world_poses(scene)
    _check_movable(item)
    target = poses[base.name].inverse().apply(poses[name].pos + np.array(by))
    x, y, z = (float(v) for v in target)
    fields = {"radius": 0.03, "low": -0.02, "high": 0.02, "released": False, "source": "own bound"}
    return Located(object=name, relative_to=base.name, target=(x, y, z), **(fields | bounds_of))


def _check_movable(item: SceneObject) -> None:
    if item.environment or item.static:
        raise SpecError(f"task: object {item.name} is fixed and cannot be moved")


def push(scene: SceneSpec, name: str, by: tuple[float, float] = (0.1, 0.0)) -> Task:
    """Push an object by a displacement in the scene's x and y [m], at half its height."""
    goal, item = _moved(scene, name, (*by, 0.0)), scene.object(name)
    way = np.array((*by, 0.0)) / max(math.hypot(*by), 1e-9)
    along = rotate(world_poses(scene)[name].quat * BACK, way)
    middle, half = _box(item)
    x, y, z = (middle - along * (np.abs(along) @ half + PUSH_M)).tolist()
    return Task(f"push {name}", scene, goal, WorkPoint(name, item.spec.root, (x, y, z), False))


def lift(scene: SceneSpec, name: str, by: float = 0.1) -> Task:
    """Lift an object by a height [m]; it need not be at rest."""
    goal = _moved(scene, name, (0, 0, 0), radius=1e3, low=by, high=1e3, rest=False)
    return Task(f"lift {name}", scene, goal, _body_point(scene.object(name)))


def place(scene: SceneSpec, name: str, *, on: str | None = None, in_: str | None = None) -> Task:
    """Place an object on the top of another, or in it, and let go."""
    if (on is None) == (in_ is None):
        raise SpecError("task place: give one of on and in_")
    item, other = scene.object(name), scene.object(on or in_ or "")
    _check_movable(item)
    if item is other:
        raise SpecError(f"task place: {name} cannot be placed on or in itself")
    middle, half = _box(other)
    own_middle, own_half = _box(item)
    foot = (float(own_middle[0]), float(own_middle[1]), float(own_middle[2] - own_half[2]))
    top = float(middle[2] + (half[2] if in_ is None else -half[2]))
    low, high = (-0.01, 0.008) if in_ is None else (-0.005, float(1.5 * half[2]))
    goal = Located(
        object=name,
        point=foot,
        relative_to=other.name,
        target=(float(middle[0]), float(middle[1]), top),
        radius=float(half[:2].min()),
        low=low,
        high=high,
        touching=(other.name,),
        source="own bound; at rest and let go: StackCube-v1 of ManiSkill",
    )
    words = f"place {name} {'on' if in_ is None else 'in'} {other.name}"
    return Task(words, scene, goal, _body_point(item), PLACE_HORIZON)


def insert(scene: SceneSpec, name: str, into: str) -> Task:
    """Place an object in another, upright."""
    task = place(scene, name, in_=into)
    upright_goal = task.goal.model_copy(update={"tilt": (0.0, math.radians(20))})
    return replace(task, goal=upright_goal, instruction=f"insert {name} into {into}")


def stack(scene: SceneSpec, name: str, on: str) -> Task:
    """Place an object on the middle of another."""
    task = place(scene, name, on=on)
    radius = float(_box(scene.object(name))[1][:2].min()) / 2
    return replace(
        task,
        goal=task.goal.model_copy(update={"radius": radius}),
        instruction=f"stack {name} on {on}",
    )


def topple(scene: SceneSpec, name: str) -> Task:
    """Make an object fall over."""
    goal = Leaning(object=name, tilt=(math.radians(60), math.pi), source="own bound")
    item = scene.object(name)
    _check_movable(item)
    return Task(f"topple {name}", scene, goal, _body_point(item, grasp=False))


def upright(scene: SceneSpec, name: str) -> Task:
    """Set an object upright."""
    goal = Leaning(object=name, tilt=(0.0, math.radians(15)), source="own bound")
    item = scene.object(name)
    _check_movable(item)
    return Task(f"set {name} upright", scene, goal, _body_point(item))


def every(*tasks: Task) -> Task:
    """Return the task of reaching several goals in one scene; the tool works on the first point."""
    parts = [leaf for task in tasks for leaf in leaves(task.goal)]
    words = ", then ".join(task.instruction for task in tasks)
    return replace(tasks[0], goal=Every(of=tuple(parts)), instruction=words)

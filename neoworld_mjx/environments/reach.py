"""Mounts from which a robot reaches a task: inverse kinematics along the task's motion.

The motion begins in front of the task's point, goes there, and follows the object or the part to
the goal. A mount is good if the arm follows without a jump, far from its joint limits, and without
touching anything but what it works on.
"""

import itertools
import math
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..export.link_frames import MARGIN_M, handle_at
from ..spec import SceneObject, bounds, link_poses, world_bounds, world_poses
from ..spec.pose import (
    Pose,
    angle_between,
    conjugate,
    from_matrix,
    from_yaw,
    pose,
    quat_mul,
    rotate,
)
from .arm import ANGLE_M, scene_state
from .controlled_scene import ControlledScene, controlled_scene
from .flying_gripper import facing_pose, handles
from .predicates import JointBetween, Located
from .robots import PREFIX, Mount, Robot
from .task import Task

AWAY_M = 0.08
"""Distance from the point at which the motion begins [m]."""
ERROR_M, ERROR_RAD = 0.006, 0.12
"""Largest errors of the tool along the motion [m], [rad]."""
FEW_JOINTS_RAD = 0.7
"""Largest error of the orientation of an arm with less than six joints [rad]."""
MARGIN = 0.04
"""Least share of a joint's range between its position and a limit."""
ENOUGH = 0.2
"""Share of a joint's range beyond which farther limits are no better."""
BEYOND, BEYOND_RAD = 0.05, 0.2
"""Distance of the motion beyond the goal's bound: as a share of a joint's range, and of a joint
without one [rad]."""
FINGER_M, FINGER_Y_M = 0.013, (0.035, 0.05, 0.065)
"""Length of the fingers beyond the tool, and distances from it at which open fingers are [m]."""
INSIDE = 0.6
"""Largest distance from the middle of a goal at which the motion ends, as a share of its radius."""
LIFT_M = 0.005
"""Height above the lowest bound of a goal to which the motion goes [m]."""
MAX_RETREAT_M = 0.03
"""Largest distance of the tool from the point that it works on [m]."""
CLEAR_M = 0.13
"""Least horizontal distance of the base's middle from objects [m]."""
STEPS = 5
"""Poses between the point and the goal."""
DROPS_M = (0.02, 0.04, 0.06, 0.08, 0.1)
"""Heights above a goal from which an object falls if the gripper does not fit there [m]."""
NOT_ROBOT = np.array([1, 1, 1, 1, 1, 0], np.uint8)
"""Groups of the geoms that are not the robot's."""
HOLD_M = 0.004
"""Least length of a handle between the fingers [m]."""
HALF_OPENING_M = 0.038
"""Half the length of a handle that fits between open fingers [m]."""
STAND_M = 0.2
"""Difference of the heights of stands under the base, the lowest that serves is taken [m]."""
MAX_STAND_M = 1.0
"""Greatest height of a stand [m]."""
SHARES = (0.45, 0.6, 0.75)
"""Distances of the base from the point, as shares of the arm's length."""
ANGLES = tuple(math.radians(a) for a in (0, 25, -25, 50, -50, 75, -75, 120, -120, 180))
"""Directions from the point to the base, relative to the side from which the tool comes [rad]."""


_TURNS = tuple(from_yaw(angle) for angle in (0.0, math.pi, math.pi / 2, -math.pi / 2))
"""Turns of the tool about its approach."""


Hold = tuple[NDArray, float]
"""Orientation of the tool, and half the length of a grasped handle along its approach [m]; infinite
for what else the tool works on."""


class Reach(NamedTuple):
    """Result of following the motion of a task with a mounted arm."""

    reaches: bool
    reason: str
    """Why it does not; empty if it does."""
    error_m: float
    """Largest error of the tool's position [m]."""
    margin: float
    """Least share of a joint's range between its position and a limit."""
    home: tuple[float, ...]
    """Joints in front of the point [rad or m]."""
    path: tuple[Pose, ...] = ()
    """Poses of the tool: in front of the point, there, and on to the goal."""
    touches: str = ""
    """Object that the open gripper touches at the goal of an object; empty for none."""


def reachable(task: Task, robot: Robot | Path | str, mount: Mount) -> Reach:
    """Return how an arm with its base at a mount follows the motion of a task."""
    controlled = controlled_scene(task.scene, robot=robot, mount=mount)
    data = mujoco.MjData(controlled.model)
    return _best_reach(task, controlled, data, mount, _handle_holds(task))


def propose_mount(task: Task, robot: Robot | Path | str) -> Mount:
    """Return a mount from which a robot reaches all of a task's motion, and its initial posture.

    Bases stand on the scene's environment, such as the floor or the table, around the task's point
    and face it. If the arm reaches from none, they stand higher.

    Raises:
        SpecError: no mount serves.
    """
    controlled = controlled_scene(task.scene, robot=robot, mount=Mount((0.0, 0.0, 0.0)))
    data = mujoco.MjData(controlled.model)
    point, handle = _point(task), _handle_holds(task)
    side, (length, _) = _side(task, point, handle), _length(controlled, data)
    lowest = _ground(task, np.full(2, 1e3), float(point[2])) or 0.0
    reasons: list[str] = []
    highest = min(max(float(point[2]) - lowest, 0.0) + STAND_M, MAX_STAND_M)
    for height in np.arange(0.0, highest + 1e-6, STAND_M):
        best: tuple[float, Mount] | None = None
        for share, angle in itertools.product(SHARES, ANGLES):
            away = side + angle
            distance = share * length
            xy = point[:2] + distance * np.array([math.cos(away), math.sin(away)])
            ground = _ground(task, xy, float(point[2]))
            if ground is None:
                continue
            x, y, z = (round(float(v), 3) for v in (*xy, ground + height))
            yaw = math.remainder(away + math.pi, 2 * math.pi)
            reach = _best_reach(task, controlled, data, Mount((x, y, z), yaw), handle)
            reasons += [reach.reason] if reach.reason else []
            score = min(reach.margin, ENOUGH) - 0.02 * abs(angle)
            if reach.reaches and (best is None or score > best[0]):
                best = score, Mount((x, y, z), yaw, reach.home)
            if best is not None and best[0] >= ENOUGH - 0.02 * abs(angle):
                break
        if best is not None:
            return best[1]
    why = max(set(reasons), key=reasons.count) if reasons else "there is no free place"
    raise SpecError(
        f"task {task.instruction!r}: the robot reaches it from no place ({why}): "
        "name another robot, or where this one stands (mount)"
    )


def _best_reach(
    task: Task,
    controlled: ControlledScene,
    data: mujoco.MjData,
    mount: Mount,
    handle: list[Hold] | None,
) -> Reach:
    """Return the best of the ways to hold the object, and to let it go.

    The ways of a handle are given, since they are the same for all mounts.
    """
    arm, model = controlled.arm, controlled.model
    assert arm is not None
    _widen(model)
    moved = pose(mount.pos, mount.quat).then(arm.root_pose)
    model.body_pos[arm.root], model.body_quat[arm.root] = moved
    best, best_score = None, (False, False, -np.inf)
    for quat, half in handle or _object_holds(task, mount.quat):
        data.qpos[:] = controlled.initial_qpos
        mujoco.mj_kinematics(controlled.model, data)
        retreat = _retreat(controlled, data, Pose(_point(task), quat))
        reach = _follow(task, controlled, data, tool_path(task, quat, retreat))
        for drop in DROPS_M:
            if not (reach.reaches and reach.touches):
                break
            raised = _follow(task, controlled, data, tool_path(task, quat, retreat, drop))
            reach = raised if raised.reaches and not raised.touches else reach
        score = reach.reaches, FINGER_M + half - retreat > HOLD_M, reach.margin
        if best is None or score > best_score:
            best, best_score = reach, score
    assert best is not None
    return best


CLEARANCE_M = 0.02
"""Least distance of the links from objects where the tool is at the point and before it [m]."""
DEPTH_M = 0.002
"""Largest penetration of the open gripper there [m]."""


def _widen(model: mujoco.MjModel) -> None:
    """Make contacts of the links appear at `CLEARANCE_M`."""
    hand = model.body_weldid[model.site(f"{PREFIX}-tool").bodyid[0]]
    for g in range(model.ngeom):
        body = model.geom_bodyid[g]
        if model.body(body).name.startswith(f"{PREFIX}-"):
            weld = model.body_weldid[body]
            gripper = hand in (weld, model.body_weldid[model.body_parentid[weld]])
            model.geom_margin[g] = 0.0 if gripper else CLEARANCE_M


def _retreat(controlled: ControlledScene, data: mujoco.MjData, tool: Pose) -> float:
    """Return how far the tool stays back, so that its open fingers end in front of a surface."""
    ahead, hit, nearest = rotate(tool.quat, (0.0, 0.0, 1.0)), np.zeros(1, np.int32), np.inf
    for side in np.outer((-1.0, 1.0), FINGER_Y_M).ravel():
        start = tool.apply((0.0, side, -AWAY_M))
        depth = mujoco.mj_ray(controlled.model, data, start, ahead, NOT_ROBOT, 1, -1, hit)
        if depth >= 0:
            nearest = min(nearest, depth - AWAY_M)
    return float(np.clip(FINGER_M - nearest, 0.0, MAX_RETREAT_M))


def _handle_holds(task: Task) -> list[Hold] | None:
    """Return the ways to work on the handle at the task's point; None if the point is on none.

    A handle is faced, or grasped from the nearest side of the object, across what fits between the
    fingers.
    """
    item, point = task.scene.object(task.point.object), task.point
    if not any(joint.child == point.part for joint in item.spec.joints):
        return None
    name = f"{item.name}-{point.part}_handle"
    facing = lambda side: facing_pose(task.scene, name, point.pos, from_side=side).quat
    if not point.grasp:
        faced = facing(False)
        return [(quat_mul(faced, turn), math.inf) for turn in _TURNS]
    handle = handle_at(item.spec, handles(task.scene)[name][1], point.pos)
    assert handle.half is not None
    half = np.array(handle.half) - MARGIN_M
    back = conjugate(_part_pose(task).quat)
    along = lambda quat, axis: float(np.abs(rotate(back, rotate(quat, np.eye(3)[axis]))) @ half)
    holds: list[Hold] = []
    for quat in (facing(False), facing(True)):
        across, turned = ([quat_mul(quat, turn) for turn in _TURNS[k : k + 2]] for k in (0, 2))
        fits = along(turned[0], 1) <= HALF_OPENING_M
        holds += [(q, along(q, 2)) for q in across + (turned if fits else [])]
    return holds


def _part_pose(task: Task) -> Pose:
    """Return the pose in the world of the part at the task's point."""
    item = task.scene.object(task.point.object)
    world = world_poses(task.scene)[item.name]
    return world.then(link_poses(item.spec, item.joint_state)[task.point.part])


def _point(task: Task) -> NDArray:
    """Return the task's point in the world [m]."""
    return _part_pose(task).apply(np.array(task.point.pos))


def tool_path(task: Task, quat: NDArray, retreat: float = 0.0, drop: float = 0.0) -> list[Pose]:
    """Return poses of the tool: in front of the task's point, there, and on to the goal.

    Args:
        task: the task.
        quat: orientation of the tool at the point.
        retreat: distance by which the tool stays back from the point [m].
        drop: height above the goal from which an object is let go [m].
    """
    item = task.scene.object(task.point.object)
    first = Pose(_point(task), quat).then(pose((0.0, 0.0, -retreat)))
    back = pose((0.0, 0.0, -AWAY_M))
    return [first.then(back), first, *_onward(task, item, first, drop)]


def _object_holds(task: Task, base: NDArray) -> list[Hold]:
    """Return the ways to take an object: from above, first across its narrower side, or ahead.

    Ahead is the direction of a base with the orientation `base`.
    """
    item = task.scene.object(task.point.object)
    low, high = bounds(item.spec, item.joint_state)
    across = 0.0 if high[1] - low[1] <= high[0] - low[0] else math.pi / 2
    x, y, _ = rotate(world_poses(task.scene)[item.name].quat, (1.0, 0.0, 0.0))
    above = quat_mul(from_yaw(math.atan2(y, x) + across), np.array([0.0, 1.0, 0.0, 0.0]))
    ahead = rotate(base, (1.0, 0.0, 0.0))
    left = np.cross((0.0, 0.0, 1.0), ahead)
    sides = [np.column_stack([np.cross(y, ahead), y, ahead]) for y in (left, -left)]
    quats = [quat_mul(turn, above) for turn in _TURNS] + [from_matrix(side) for side in sides]
    return [(quat, math.inf) for quat in quats]


def _onward(task: Task, item: SceneObject, first: Pose, drop: float) -> list[Pose]:
    """Return the poses of the tool while it moves the part or the object to the goal."""
    goal, path = task.goal, []
    world, here = world_poses(task.scene)[item.name], _part_pose(task)
    if isinstance(goal, JointBetween) and goal.object == item.name:
        joint = item.spec.joint(goal.joint)
        now = float(item.joint_state.get(goal.joint, 0.0))
        width = 1.0 if goal.absolute else joint.upper - joint.lower
        offset = 0.0 if goal.absolute else joint.lower
        low, high = (offset + width * bound for bound in (goal.low, goal.high))
        beyond = BEYOND_RAD if goal.absolute else BEYOND * width
        end = min(max(now, low + beyond), high - beyond)
        if joint.type != "continuous":
            end = min(max(end, joint.lower), joint.upper)
        for k in range(1, STEPS + 1):
            state = {**item.joint_state, goal.joint: now + k / STEPS * (end - now)}
            there = world.then(link_poses(item.spec, state)[task.point.part])
            path.append(there.then(here.inverse()).then(first))
    elif isinstance(goal, Located) and goal.object == item.name:
        relative = world_poses(task.scene)[goal.relative_to]
        point = relative.inverse().apply(world.apply(goal.point))
        aimed = np.array(goal.target)
        apart = point[:2] - aimed[:2]
        # The nearest place within the goal, at some distance from its edge; a push falls short, and
        # what falls must not fall on the edge.
        inside = INSIDE if task.point.grasp and not drop else 0.0
        aimed[:2] += apart * min(1.0, inside * goal.radius / max(np.linalg.norm(apart), 1e-9))
        aimed[2] += min(max(point[2] - aimed[2], goal.low + LIFT_M), goal.high) + drop
        shift = rotate(relative.quat, aimed - point)
        path = [Pose(first.pos + k / STEPS * shift, first.quat) for k in range(1, STEPS + 1)]
    return path


def _follow(
    task: Task, controlled: ControlledScene, data: mujoco.MjData, path: list[Pose]
) -> Reach:
    """Solve for the joints along a path, each from the solution before."""
    arm, model = controlled.arm, controlled.model
    assert arm is not None
    length, shoulder = _length(controlled, data)
    worst, margin, home = 0.0, np.inf, arm.home
    if max(np.linalg.norm(target.pos - shoulder) for target in path) > length:
        return Reach(False, "it is too far away", np.inf, -1.0, tuple(home))
    for k, target in enumerate(path):
        tries = 4 if k == 0 else 1
        error_m = error_rad = np.inf
        for attempt in range(tries):
            if k == 0:
                spread = np.random.default_rng(attempt).normal(size=len(arm.home))
                start = arm.home + 0.6 * spread * (attempt > 0)
                data.qpos[arm.qpos] = np.clip(start, arm.low, arm.high)
            error_m, error_rad = _solve_pose(controlled, data, target)
            allowed = ERROR_RAD if len(arm.home) >= 6 else FEW_JOINTS_RAD
            if error_m <= ERROR_M and error_rad <= allowed:
                break
        else:
            reason = "it cannot get there" if k < 2 else "it cannot follow the motion"
            return Reach(False, reason, error_m, -1.0 + k / 10, tuple(home))
        q = data.qpos[arm.qpos]
        if k == 0:
            home = q.copy()
        worst = max(worst, error_m)
        share = np.minimum(q - arm.low, arm.high - q) / (arm.high - arm.low)
        margin = min(margin, float(share.min()))
        if k <= 1 and (touched := _touched(model, data)):
            return Reach(False, f"it touches {touched}", worst, -0.5, tuple(home))
    if margin < MARGIN:
        return Reach(False, "a joint is at its limit", worst, margin, tuple(home))
    placed = isinstance(task.goal, Located) and task.goal.released and task.point.grasp
    touched = _touched(model, data) if placed else ""
    home = tuple(float(v) for v in home)
    return Reach(True, "", worst, margin, home, tuple(path), touched)


def _solve_pose(
    controlled: ControlledScene, data: mujoco.MjData, target: Pose
) -> tuple[float, float]:
    """Move the arm to a pose of its tool; return the errors [m], [rad]."""
    arm, model = controlled.arm, controlled.model
    assert arm is not None
    scale = np.array([1.0] * 3 + [ANGLE_M] * 3)
    error_m = error_rad = np.inf
    for _ in range(40):
        mujoco.mj_kinematics(model, data)
        state = scene_state(data)
        pos, quat = arm.tool(state)
        turn = np.zeros(3)
        mujoco.mju_quat2Vel(turn, quat_mul(target.quat, conjugate(quat)), 1.0)
        apart = target.pos - pos
        error_m, error_rad = float(np.linalg.norm(apart)), float(angle_between(quat, target.quat))
        if error_m < 1e-3 and error_rad < 1e-2:
            break
        twist = np.concatenate([apart * min(1.0, 0.2 / max(error_m, 1e-9)), 0.5 * turn]) * scale
        jacobian = arm.jacobian(state) * scale[:, None]
        gram = jacobian @ jacobian.T + 0.02**2 * np.eye(6)
        step = jacobian.T @ np.linalg.solve(gram, twist)
        q = data.qpos[arm.qpos] + np.clip(step, -0.4, 0.4)
        data.qpos[arm.qpos] = np.clip(q, arm.low, arm.high)
    return error_m, error_rad


def _touched(model: mujoco.MjModel, data: mujoco.MjData) -> str:
    """Return the object that the robot with open fingers is too near to; empty for none."""
    mujoco.mj_forward(model, data)
    for k in range(data.ncon):
        contact = data.contact[k]
        names = [model.body(model.geom_bodyid[g]).name for g in contact.geom]
        owners = [name.split("-", 1)[0] for name in names]
        if PREFIX not in owners or contact.dist > contact.includemargin - DEPTH_M:
            continue
        return owners[1 - owners.index(PREFIX)]
    return ""


def _side(task: Task, point: NDArray, handle: list[Hold] | None) -> float:
    """Return the direction from the point to where the tool comes from [rad]."""
    if handle is not None:
        out = -rotate(handle[0][0], (0.0, 0.0, 1.0))
        if np.linalg.norm(out[:2]) > 0.3:
            return math.atan2(out[1], out[0])
    camera = task.scene.camera
    x, y = camera.xy if camera is not None else (0.0, 0.0)
    return math.atan2(y - point[1], x - point[0])


def _length(controlled: ControlledScene, data: mujoco.MjData) -> tuple[float, NDArray]:
    """Return the length of the stretched arm from its second joint, and where that is [m]."""
    arm = controlled.arm
    assert arm is not None
    data.qpos[:] = controlled.initial_qpos
    mujoco.mj_kinematics(controlled.model, data)
    state = scene_state(data)
    anchors = state.xpos[arm.bodies] + rotate(state.xquat[arm.bodies], arm.anchors)
    points = np.vstack([anchors[1:], arm.tool(state)[0]])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()), anchors[1]


def _ground(task: Task, xy: NDArray, height: float) -> float | None:
    """Return the top of the environment under a base [m]; None if objects are in the way.

    Outside of the environment, a base stands on a stand as high as its nearest surface below the
    point.
    """
    poses, tops = world_poses(task.scene), []
    for item in task.scene.objects:
        low, high = world_bounds(item, poses[item.name])
        inside = np.all((xy > low[:2] - CLEAR_M) & (xy < high[:2] + CLEAR_M))
        if item.environment:
            if high[2] <= height + 0.05:
                tops.append(float(high[2]))
        elif inside:
            return None
    return max(tops) if tops else 0.0

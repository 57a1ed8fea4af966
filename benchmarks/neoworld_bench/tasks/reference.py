"""Reference plans, computed from the ground truth: poses of objects, grasps, handles and joint
axes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.export.link_frames import MARGIN_M, frames
from neoworld_mjx.spec import (
    JointSpec,
    ObjectSpec,
    SceneSpec,
    Vec3,
    bounds,
    joint_position,
    link_poses,
    pieces,
    world_poses,
)
from neoworld_mjx.spec.convex import box_around
from neoworld_mjx.spec.kinematics import welded
from neoworld_mjx.spec.pose import Pose, conjugate, quat_mul, rotate

from .plan_format import MAX_OPENING, TaskPlan, ToolMove, rotation

SLACK_M = 0.004
"""Clearance on either side of a gripped object [m]."""
ABOVE_M = 0.05
"""Distance of the tool's start from the grasp [m]."""
TIP_M = 0.008
"""Length of the fingers beyond the center of the pads [m]."""
CARRY_M_S, LOWER_M_S = 0.25, 0.06
"""Speeds of free motion and of lowering [m/s]."""
FINGERS_M = 0.008
"""Half the thickness of the two closed fingers [m]."""


@dataclass(frozen=True)
class Grasp:
    """Position of the fingers on an object, in its frame."""

    point: Vec3
    """Center between the pads [m]."""
    width: float
    """Distance of the two held surfaces [m]."""
    approach: Vec3 = (0.0, 0.0, -1.0)
    closing: Vec3 = (0.0, 1.0, 0.0)
    slack: float = SLACK_M
    """Clearance on either side before the fingers close [m]."""


def pick_and_place(
    scene: SceneSpec,
    name: str,
    grasp: Grasp,
    goal: Pose,
    *,
    clear: float = 0.12,
    hover: float = 0.03,
    drop: float = 0.002,
    retreat: float = 0.08,
) -> TaskPlan:
    """Return a plan that grips an object, lifts it, moves it over its goal, lowers and releases it.

    Args:
        scene: the scene in its composed state.
        name: the object.
        grasp: where to hold it.
        goal: pose of the object in the world to let it go at, less `drop`.
        clear: how far to lift it [m].
        hover: how far above the goal the slow part of the way begins [m].
        drop: how far above the goal to let go [m].
        retreat: how far to draw the fingers back [m].
    """
    object_pose = world_poses(scene)[name]
    approach = rotate(object_pose.quat, grasp.approach)
    start = object_pose.apply(np.array(grasp.point))
    turn = rotation_vector(quat_mul(goal.quat, conjugate(object_pose.quat)))
    end = goal.apply(np.array(grasp.point)) + (0, 0, drop)
    grasp_width = grasp.width
    open_width = min(grasp_width + 2 * grasp.slack, MAX_OPENING)
    up = np.array([0.0, 0.0, max(clear, end[2] + hover - start[2])])
    across = end + (0, 0, hover) - (start + up)
    back = -retreat * rotate(rotation(turn), approach)
    return TaskPlan(
        position=_vec(start - ABOVE_M * approach),
        approach=_vec(approach),
        closing=_vec(rotate(object_pose.quat, grasp.closing)),
        opening=open_width,
        moves=(
            _move(ABOVE_M * approach, open_width, 1.0),
            ToolMove(opening=0, seconds=0.5),
            _move(up, 0, _pace(up, CARRY_M_S)),
            _move(across, 0, _pace(across, CARRY_M_S, turn), turn=turn),
            _move((0, 0, -hover), 0, max(0.5, hover / LOWER_M_S)),
            ToolMove(
                opening=min(grasp_width + 2 * max(grasp.slack, SLACK_M), MAX_OPENING), seconds=0.5
            ),
            _move(back, min(grasp_width + 2 * max(grasp.slack, SLACK_M), MAX_OPENING), 0.6),
        ),
    )


def push(
    start: Sequence[float] | NDArray,
    displacement: Sequence[float] | NDArray,
    *,
    approach: Vec3 = (0.0, 0.0, -1.0),
    closing: Vec3 | None = None,
    opening: float = 0.0,
    speed: float = 0.1,
    retreat: float = 0.0,
) -> TaskPlan:
    """Return a plan that moves closed fingers along a line, as in the paper.

    Args:
        start: the tool's start [m].
        displacement: of the tool [m].
        approach: direction of the fingers.
        closing: direction of their closing; across the displacement by default.
        opening: distance of the pads [m].
        speed: mean speed [m/s].
        retreat: how far to draw back in the end [m].
    """
    way = np.asarray(displacement, float)
    if closing is None:
        side = np.cross(approach, way)
        closing = _vec(side if np.linalg.norm(side) > 1e-6 else (0.0, 1.0, 0.0))
    moves = [_move(way, opening, _pace(way, speed))]
    if retreat:
        moves.append(_move(-retreat * way / np.linalg.norm(way), opening, 0.6))
    return TaskPlan(
        position=_vec(start),
        approach=approach,
        closing=closing,
        opening=opening,
        moves=tuple(moves),
    )


@dataclass(frozen=True)
class Hold:
    """Method of moving a joint: grip its handle, poke it, or press the side of the fingers on it.

    Directions are along the object's axes in the part's current pose, by name: +x, -y.
    """

    way: str
    """"grip", "poke" or "side"."""
    approach: str
    closing: str = "+y"
    """Ignored by poke and side."""
    geom: str = ""
    """Geom to hold instead of the object's handle frame."""
    spot: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position on the held box, in half edges from its center."""


def work_joint(scene: SceneSpec, name: str, joint: str, target: float, hold: Hold) -> TaskPlan:
    """Return a plan that moves a joint's handle along its path to a value.

    Args:
        scene: the scene in its composed state.
        name: the object.
        joint: the joint, which is no ball.
        target: its value at the end [rad or m].
        hold: how to hold the handle.

    Raises:
        ValueError: the plan would leave its bounds, such as a handle wider than the fingers open.
    """
    item = scene.object(name)
    moving = item.spec.joint(joint)
    object_pose = world_poses(scene)[name]
    value = joint_position(item.spec, moving, item.joint_state)
    if isinstance(value, tuple):
        raise ValueError(f"joint {joint} is a ball")
    part_poses = link_poses(item.spec, item.joint_state)
    part, base = (
        object_pose.then(part_poses[moving.child]),
        object_pose.then(part_poses[moving.parent]),
    )
    middle, half = _held_box(item.spec, joint, hold.geom)
    point = part.apply(middle + half * np.array(hold.spot))
    axis, anchor = rotate(base.quat, moving.axis), base.apply(np.array(moving.pos))
    change = target - value
    approach = rotate(part.quat, _axis(hold.approach))
    ahead = rotate(base.quat, (1.0, 0.0, 0.0))
    way = _direction(moving, axis, anchor, point, ahead) * np.sign(change)
    if hold.way == "grip":
        closing = rotate(part.quat, _axis(hold.closing))
        width = 2 * float(np.abs(_axis(hold.closing)) @ half)
        open_width = width + 2 * SLACK_M
        first = [_move(ABOVE_M * approach, open_width, 1.0), ToolMove(opening=0, seconds=0.5)]
        start, grip = point - ABOVE_M * approach, 0.0
    else:
        local = rotate(conjugate(part.quat), way)
        reach = float(np.abs(local) @ half) + 0.003
        grip = open_width = 0.0
        if hold.way == "poke":
            start = point - way * (reach + TIP_M)
            approach = way
            side = np.array([0.0, 0.0, 1.0]) if abs(way[2]) < 0.7 else np.array([0.0, 1.0, 0.0])
            closing, first = np.cross(way, side), []
        else:
            start = point - way * (reach + FINGERS_M)
            closing, first = way, [_move(ABOVE_M * approach, 0.0, 0.6)]
            start = start - ABOVE_M * approach
        change += math.copysign(0.004 / _arm(moving, axis, anchor, point), change)
    move = _along(moving, axis, anchor, change, grip, point)
    return TaskPlan(
        position=_vec(start),
        approach=_vec(approach),
        closing=_vec(closing),
        opening=open_width,
        moves=(*first, move),
    )


def _held_box(spec: ObjectSpec, joint: str, geom: str) -> tuple[NDArray, NDArray]:
    """Return the center and half edges of the held box, in the object's frame at rest [m]."""
    if not geom:
        handle = next(f for f in frames(spec) if f.joint == joint)
        half = np.full(3, 0.006) if handle.half is None else np.array(handle.half)
        # Frames widen what is held by MARGIN_M.
        return np.array(handle.pos), half - np.where(half > MARGIN_M, MARGIN_M, 0.0)
    low, high = _geom_boxes(spec, joint)[geom]
    return (low + high) / 2, (high - low) / 2


def _geom_boxes(spec: ObjectSpec, joint: str) -> dict[str, tuple[NDArray, NDArray]]:
    group = welded(spec)
    boxes: dict[str, tuple[NDArray, NDArray]] = {}
    for part in spec.parts:
        if group[part.name] != group[spec.joint(joint).child]:
            continue
        for geom, piece, at in pieces(part):
            low, high = box_around(piece, at)
            if geom.name in boxes:
                low = np.minimum(low, boxes[geom.name][0])
                high = np.maximum(high, boxes[geom.name][1])
            boxes[geom.name] = (low, high)
    return boxes


def _along(
    joint: JointSpec,
    axis: NDArray,
    anchor: NDArray,
    change: float,
    opening: float,
    point: NDArray,
) -> ToolMove:
    if joint.type == "prismatic":
        way = change * axis
        return _move(way, opening, _pace(way, 0.12))
    length = abs(change) * _arm(joint, axis, anchor, point)
    return ToolMove(
        turn=_vec(change * axis),
        about=_vec(anchor),
        opening=opening,
        seconds=min(6.0, max(1.0, length / 0.15, abs(change) / 0.8)),
    )


def _arm(joint: JointSpec, axis: NDArray, anchor: NDArray, point: NDArray) -> float:
    """Return the displacement of a point per unit of a joint [m]."""
    if joint.type == "prismatic":
        return 1.0
    arm = point - anchor
    return max(0.005, float(np.linalg.norm(arm - (arm @ axis) * axis)))


def _direction(
    joint: JointSpec, axis: NDArray, anchor: NDArray, point: NDArray, ahead: NDArray
) -> NDArray:
    """Return the direction in which a joint moves a point; `ahead` for a point on the axis."""
    if joint.type == "prismatic":
        return axis
    way = np.cross(axis, point - anchor)
    length = float(np.linalg.norm(way))
    return way / length if length > 1e-4 else ahead


def grasp_box(
    scene: SceneSpec, name: str, *, depth: float = 0.02, along: str | None = None
) -> Grasp:
    """Return a grasp of an object from above by its narrower sides.

    Args:
        scene: the scene.
        name: an object that stands upright.
        depth: how far below its top the middle of the pads is [m].
        along: closing axis, "x" or "y"; the narrower one by default.
    """
    low, high = bounds(scene.object(name).spec)
    edges = high - low
    k = {"x": 0, "y": 1}[along] if along else int(np.argmin(edges[:2]))
    closing = (1.0, 0.0, 0.0) if k == 0 else (0.0, 1.0, 0.0)
    middle = (low + high) / 2
    height = max(high[2] - depth, low[2] + TIP_M + 0.002)
    return Grasp(
        (float(middle[0]), float(middle[1]), float(height)), float(edges[k]), closing=closing
    )


def rotation_vector(quat: NDArray) -> Vec3:
    """Return a rotation's vector [rad], at most pi long."""
    q = quat if quat[0] >= 0 else -quat
    sine = float(np.linalg.norm(q[1:]))
    if sine < 1e-9:
        return (0.0, 0.0, 0.0)
    return _vec(2 * math.atan2(sine, float(q[0])) * q[1:] / sine)


def _move(
    displacement: Sequence[float] | NDArray, opening: float, seconds: float, turn: Vec3 = (0, 0, 0)
) -> ToolMove:
    return ToolMove(displacement=_vec(displacement), turn=turn, opening=opening, seconds=seconds)


def _pace(way: NDArray, speed: float, turn: Vec3 = (0.0, 0.0, 0.0)) -> float:
    return float(min(6.0, max(0.5, np.linalg.norm(way) / speed, float(np.linalg.norm(turn)) / 1.2)))


def _axis(name: str) -> NDArray:
    direction = np.zeros(3)
    direction["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return direction


def _vec(values: Sequence[float] | NDArray) -> Vec3:
    # A ten-thousandth of a millimetre: what is computed is the same on every machine.
    x, y, z = (round(float(v), 7) + 0.0 for v in values)
    return x, y, z

"""Settling of an object on a parent that is not level, such as a spoon on a saucer.

The search does not change tilts. An object at its parsed tilt would turn by some degrees in every
rollout until it rests. This motion would mask other errors of a candidate.
"""

import itertools
from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..physics.mjcf import body_name, to_mjspec
from ..spec import SceneObject, SceneSpec, bounds, support_frame, world_poses
from ..spec.pose import (
    IDENTITY,
    Pose,
    angle_between,
    conjugate,
    from_yaw,
    pose,
    quat_mul,
    rotate,
    yaw_of,
)
from .inside import position_inside
from .resting_pose import MAX_TILT_RAD

FALL_M_S = 0.1
"""Terminal speed of the fall [m/s]. The drag prevents bouncing and sliding past the resting
pose."""
MAX_DURATION_S, TIMESTEP_S, CHECK_INTERVAL_S = 8.0, 0.002, 0.1
STILL_M_S, CREEP_M_S = 5e-4, 0.003
"""Speeds of an object's ends [m/s]. Below the first speed, the object is at rest. If it is below
the second speed at the time limit, only its contacts creep, which never stops on a slope."""
MAX_PENETRATION_M, LIFT_M = 1e-4, 0.002
MAX_SHIFT, MAX_SHIFT_INSIDE = 0.25, 1.0
"""Largest horizontal shift relative to the object's diagonal, outside and inside a container. It is
larger in a container, because the object must enter the container."""
DROP_FRACTIONS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Fractions of the offset to a container's center by which an object is moved before it is
dropped."""
SOLE_M = 0.002
"""Height above an object's lowest point up to which points count as lowest points [m]."""
SHIFT_COST = 0.2
"""Cost of a horizontal shift of the resting pose, as a height per distance."""
JOINT_DRAG = 1e6
"""Drag of joints relative to the drag of the fall. It keeps joints at their parsed positions."""


def settle(
    parent: SceneObject, obj: SceneObject, others: Iterable[SceneObject] = ()
) -> SceneObject | None:
    """Settle an object on or in its parent, in a simulation with strong drag.

    At its parsed position, an object in a container may penetrate the container's wall, and would
    settle on the rim. Therefore, it is also dropped with its lowest points nearer to the center,
    and from a position where it would stand upright inside. The resting pose with the lowest cost
    is returned. The cost depends on the height, the change of tilt and the horizontal shift.

    Args:
        parent: the parent, which does not move.
        obj: the object; it is first lifted until it touches nothing.
        others: objects already in the container, see `position_inside`; they are not simulated.

    Returns:
        The object with the heading, tilt and position of its resting pose. None if there is no
        resting pose within 30 degrees and a horizontal shift of a quarter of the object's diagonal,
        or of the whole diagonal in a container.

    Raises:
        SpecError: MuJoCo cannot compile the two objects.
    """
    as_root = {"parent": None, "parent_link": None, "environment": True, "xy": (0.0, 0.0)}
    base = parent.model_copy(update={**as_root, "z": 0.0, "yaw": 0.0})
    scene = SceneSpec(name="rest", objects=(base, obj))
    try:
        model = to_mjspec(scene, timestep=TIMESTEP_S).compile()
    except ValueError as error:
        raise SpecError(f"{obj.name} on {parent.name}: {error}") from None
    root = model.body(obj.name)
    dofs = model.jnt_dofadr[int(root.jntadr[0])] + np.arange(6)
    size = float(np.linalg.norm(np.subtract(*bounds(obj.spec, obj.joint_state, obj.base_tilt))))
    drag = float(root.subtreemass[0]) * float(np.linalg.norm(scene.gravity)) / FALL_M_S
    model.dof_damping[:] = JOINT_DRAG * drag
    model.dof_damping[dofs] = np.repeat([drag, drag * (size / 2) ** 2], 3)
    poses = world_poses(scene)
    frame = support_frame(base, poses[base.name], obj.parent_link)
    start = frame.inverse().then(poses[obj.name])
    best, least_cost = None, np.inf
    container = body_name(base, obj.parent_link or base.spec.root)
    parsed_quat = poses[obj.name].quat
    drops = [
        (shift, parsed_quat) for shift in _shifts(model, root.id, obj, model.body(container).id)
    ]
    tilt = float(angle_between(obj.base_tilt, IDENTITY))
    position = (
        position_inside(parent, obj, others)
        if obj.relation == "in" and tilt < MAX_TILT_RAD
        else None
    )
    if position is not None:
        # The object fits into a narrow hole only if it is upright.
        upright = quat_mul(frame.quat, from_yaw(obj.yaw))
        drops.append((rotate(frame.quat, [*np.subtract(position, obj.xy), 0.0])[:2], upright))
    for shift, quat in drops:
        end, height = _drop(model, root.id, shift, quat, size)
        settled = (
            None if end is None else _settled_object(obj, frame.inverse().then(end), start, size)
        )
        if settled is None:
            continue
        # The tilt term penalizes an object that got stuck on the rim.
        cost = height + size / 2 * float(angle_between(obj.base_tilt, settled.base_tilt))
        cost += SHIFT_COST * float(np.hypot(*np.subtract(settled.xy, obj.xy)))
        if cost < least_cost:
            best, least_cost = settled, cost
    return best


def _shifts(model: mujoco.MjModel, body: int, obj: SceneObject, container: int) -> list[NDArray]:
    """Return the horizontal shifts [m] from the parsed position from which an object is dropped."""
    if obj.relation != "in":
        return [np.zeros(2)]
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    corners = _corners(model, data, container)
    object_corners = _corners(model, data, body)
    center = (corners.min(axis=0) + corners.max(axis=0))[:2] / 2
    sole = object_corners[object_corners[:, 2] < object_corners[:, 2].min() + SOLE_M]
    offset = center - sole.mean(axis=0)[:2]
    return [fraction * offset for fraction in DROP_FRACTIONS]


def _corners(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> NDArray:
    """Return the corners of the collision geoms' boxes in a body's subtree, in the world frame."""
    ids = np.arange(model.nbody)
    parts = ids == body
    for child in ids[body + 1 :]:
        parts[child] |= parts[model.body_parentid[child]]
    geoms = np.flatnonzero(parts[model.geom_bodyid] & (model.geom_contype > 0))
    sides = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    box = model.geom_aabb[geoms]
    local = box[:, None, :3] + sides * box[:, None, 3:]
    rotation = data.geom_xmat[geoms].reshape(-1, 1, 3, 3)
    return (data.geom_xpos[geoms][:, None] + np.einsum("gkij,gkj->gki", rotation, local)).reshape(
        -1, 3
    )


def _drop(
    model: mujoco.MjModel, body: int, shift: NDArray, quat: NDArray, size: float
) -> tuple[Pose | None, float]:
    """Drop a body at a shift and rotation; return its resting pose and center of mass height [m].

    The pose is None if the body does not settle.
    """
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    joint = model.body_jntadr[body]
    data.qpos[model.jnt_qposadr[joint] + np.arange(2)] += shift
    data.qpos[model.jnt_qposadr[joint] + 3 + np.arange(4)] = quat
    if not _lift_free(model, data, body, size):
        return None, np.inf
    dofs = model.jnt_dofadr[joint] + np.arange(6)
    speed = np.inf
    for _ in range(round(MAX_DURATION_S / CHECK_INTERVAL_S)):
        mujoco.mj_step(model, data, round(CHECK_INTERVAL_S / TIMESTEP_S))
        speed = float((np.abs(data.qvel[dofs]) * np.repeat([1.0, size / 2], 3)).max())
        if speed < STILL_M_S:
            break
    if not speed < CREEP_M_S:
        return None, np.inf
    end = pose(data.body(body).xpos, data.body(body).xquat)
    return end, float(data.body(body).subtree_com[2])


def _settled_object(obj: SceneObject, end: Pose, start: Pose, size: float) -> SceneObject | None:
    """Return an object at its resting pose, or None if that is too far from the parsed pose.

    Args:
        obj: the object.
        end: resting pose in the parent's frame.
        start: parsed pose in the parent's frame.
        size: diagonal of the object [m].
    """
    heading = yaw_of(quat_mul(end.quat, conjugate(start.quat)))
    tilt = quat_mul(conjugate(from_yaw(obj.yaw + heading)), end.quat)
    shift = float(np.linalg.norm(end.pos[:2] - np.array(obj.xy)))
    limit = MAX_SHIFT_INSIDE if obj.relation == "in" else MAX_SHIFT
    if angle_between(obj.base_tilt, tilt) > MAX_TILT_RAD or shift > limit * size:
        return None
    return obj.model_copy(
        update={
            "xy": tuple(end.pos[:2].tolist()),
            "z": float(end.pos[2]),
            "yaw": obj.yaw + heading,
            "base_tilt": tuple((tilt / np.linalg.norm(tilt)).tolist()),
        }
    )


def _lift_free(model: mujoco.MjModel, data: mujoco.MjData, body: int, limit: float) -> bool:
    """Lift a free body until it penetrates nothing; return False if that exceeds `limit` [m]."""
    height = int(model.jnt_qposadr[model.body_jntadr[body]]) + 2
    tree = model.body_rootid[model.geom_bodyid]
    for _ in range(round(limit / LIFT_M) + 1):
        mujoco.mj_forward(model, data)
        # Contacts between parts of the parent do not count.
        touches = np.count_nonzero(tree[data.contact.geom] == body, axis=1) == 1
        if not np.any(data.contact.dist[touches] < -MAX_PENETRATION_M):
            return True
        data.qpos[height] += LIFT_M
    return False

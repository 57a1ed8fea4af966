"""Settle an object onto a parent that is not level, such as a spoon onto a saucer.

The search does not move tilts. An object that starts at its parsed tilt settles by some degrees in
every rollout, and that drift hides what else is wrong with a candidate.
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
from .inside import entrance
from .resting_pose import MAX_TILT_RAD

FALL_M_S = 0.1
"""Terminal speed of the fall: the drag lets the object neither bounce nor slide past its rest."""
MAX_DURATION_S, TIMESTEP_S, CHECK_INTERVAL_S = 4.0, 0.002, 0.1
STILL_M_S, CREEP_M_S = 5e-4, 0.003
"""Speeds of an object's ends: below the first it rests; below the second at the end of the time its
contacts only creep, which on a slope they do for ever."""
CLEAR_M, LIFT_M = 1e-4, 0.002
MAX_SHIFT, MAX_SHIFT_INSIDE = 0.25, 1.0
"""Horizontal shift over the object's diagonal beyond which it rests somewhere else; what is known
to be in a container must get there."""
LET_DOWN = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of the way to a container's middle by which an object's lowest points are moved."""
SOLE_M = 0.002
"""Height within which points are an object's lowest."""
SHIFT_COST = 0.2
"""Height that a resting pose must gain over the horizontal shift to it."""
JOINT_DRAG = 1e6
"""Drag of joints over that of the fall: they keep their parsed positions."""


def settle(
    parent: SceneObject, obj: SceneObject, others: Iterable[SceneObject] = ()
) -> SceneObject | None:
    """Let an object come to rest on or in its parent, in a simulation with strong drag.

    What is in a container may pierce its wall as parsed, and would end up on the rim. So it is also
    let down with its lowest points nearer to the middle, and where it would stand upright inside;
    the lowest resting pose that is not tilted for it is taken.

    Args:
        parent: its parent, which does not move.
        obj: the object; it is first lifted until it touches nothing.
        others: what is in the container already, see `entrance`; they are not simulated.

    Returns:
        The object with the heading, tilt and place of its resting pose, or None if it has none
        within 30 degrees and a quarter of its size, in a container within its size.

    Raises:
        SpecError: MuJoCo cannot compile the two.
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
    at = world_poses(scene)
    frame = support_frame(base, at[base.name], obj.parent_link)
    start = frame.inverse().then(at[obj.name])
    best, least = None, np.inf
    container = body_name(base, obj.parent_link or base.spec.root)
    turned = at[obj.name].quat
    starts = [(way, turned) for way in _shifts(model, root.id, obj, model.body(container).id)]
    tilt = float(angle_between(obj.base_tilt, IDENTITY))
    place = entrance(parent, obj, others) if obj.relation == "in" and tilt < MAX_TILT_RAD else None
    if place is not None:
        # A narrow hole takes it upright only.
        upright = quat_mul(frame.quat, from_yaw(obj.yaw))
        starts.append((rotate(frame.quat, [*np.subtract(place, obj.xy), 0.0])[:2], upright))
    for shift, quat in starts:
        end, height = _rest(model, root.id, shift, quat, size)
        resting = None if end is None else _resting(obj, frame.inverse().then(end), start, size)
        if resting is None:
            continue
        # An end that got stuck on the rim is as high as its tilt.
        cost = height + size / 2 * float(angle_between(obj.base_tilt, resting.base_tilt))
        cost += SHIFT_COST * float(np.hypot(*np.subtract(resting.xy, obj.xy)))
        if cost < least:
            best, least = resting, cost
    return best


def _shifts(model: mujoco.MjModel, body: int, obj: SceneObject, container: int) -> list[NDArray]:
    """Return where an object is let down, as horizontal shifts [m] from where it was parsed."""
    if obj.relation != "in":
        return [np.zeros(2)]
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    corners = _corners(model, data, container)
    own = _corners(model, data, body)
    middle = (corners.min(axis=0) + corners.max(axis=0))[:2] / 2
    sole = own[own[:, 2] < own[:, 2].min() + SOLE_M]
    way = middle - sole.mean(axis=0)[:2]
    return [share * way for share in LET_DOWN]


def _corners(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> NDArray:
    """Return the corners of the colliders' boxes of a body's subtree, in the world."""
    ids = np.arange(model.nbody)
    parts = ids == body
    for child in ids[body + 1 :]:
        parts[child] |= parts[model.body_parentid[child]]
    geoms = np.flatnonzero(parts[model.geom_bodyid] & (model.geom_contype > 0))
    sides = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    box = model.geom_aabb[geoms]
    local = box[:, None, :3] + sides * box[:, None, 3:]
    turn = data.geom_xmat[geoms].reshape(-1, 1, 3, 3)
    return (data.geom_xpos[geoms][:, None] + np.einsum("gkij,gkj->gki", turn, local)).reshape(-1, 3)


def _rest(
    model: mujoco.MjModel, body: int, shift: NDArray, quat: NDArray, size: float
) -> tuple[Pose | None, float]:
    """Let a body down at a shift, turned so; return where it rests, and how high its middle is.

    The pose is None if it does not come to rest.
    """
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    joint = model.body_jntadr[body]
    data.qpos[model.jnt_qposadr[joint] + np.arange(2)] += shift
    data.qpos[model.jnt_qposadr[joint] + 3 + np.arange(4)] = quat
    if not _lifted(model, data, body, size):
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


def _resting(obj: SceneObject, end: Pose, start: Pose, size: float) -> SceneObject | None:
    """Return an object at its resting pose, unless that is somewhere else than was parsed.

    Args:
        obj: the object.
        end: its pose at rest, in its parent's frame.
        start: the parsed pose there.
        size: its diagonal [m].
    """
    heading = yaw_of(quat_mul(end.quat, conjugate(start.quat)))
    tilt = quat_mul(conjugate(from_yaw(obj.yaw + heading)), end.quat)
    shift = float(np.linalg.norm(end.pos[:2] - np.array(obj.xy)))
    most = MAX_SHIFT_INSIDE if obj.relation == "in" else MAX_SHIFT
    if angle_between(obj.base_tilt, tilt) > MAX_TILT_RAD or shift > most * size:
        return None
    return obj.model_copy(
        update={
            "xy": tuple(end.pos[:2].tolist()),
            "z": float(end.pos[2]),
            "yaw": obj.yaw + heading,
            "base_tilt": tuple((tilt / np.linalg.norm(tilt)).tolist()),
        }
    )


def _lifted(model: mujoco.MjModel, data: mujoco.MjData, body: int, most: float) -> bool:
    """Lift a free body until it is in nothing else."""
    height = int(model.jnt_qposadr[model.body_jntadr[body]]) + 2
    tree = model.body_rootid[model.geom_bodyid]
    for _ in range(round(most / LIFT_M) + 1):
        mujoco.mj_forward(model, data)
        # Contacts between parts of the parent do not count.
        touches = np.count_nonzero(tree[data.contact.geom] == body, axis=1) == 1
        if not np.any(data.contact.dist[touches] < -CLEAR_M):
            return True
        data.qpos[height] += LIFT_M
    return False

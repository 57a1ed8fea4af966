"""Things that lie on what is not level, such as a spoon on a saucer: they are let down onto it.

The search moves four numbers, tilt not among them. A thing that starts at a tilt seen in a photograph
settles by some degrees in every rollout, and hides behind that what else is wrong with a candidate.
"""

import mujoco
import numpy as np

from ..errors import SpecError
from ..physics.mjcf import to_mjspec
from ..spec import SceneObject, SceneSpec, bounds, support_frame, world_poses
from ..spec.pose import angle_between, conjugate, from_yaw, pose, quat_mul, yaw_of
from .lying import MOST_RAD

FALL_M_S = 0.1
"""How fast a thing sinks: in so viscous a medium that it neither bounces nor slides past its rest."""
LONGEST_S, TIMESTEP_S, CHECKED_S = 4.0, 0.002, 0.1
STILL_M_S, CREEP_M_S = 5e-4, 0.003
"""Speeds of a thing's ends: below the one it rests; below the other at the end of the time its contacts
creep, which on a slope they do for ever."""
CLEAR_M, LIFT_M = 1e-4, 0.002
ASIDE = 0.25
"""How far a thing may move aside, over its diagonal: beyond this it has come to lie elsewhere."""
HEAVY = 1e6


def settled(parent: SceneObject, item: SceneObject) -> SceneObject | None:
    """Return an object as it comes to rest on its parent alone, near to how it stands.

    Args:
        parent: what carries it, which does not move meanwhile.
        item: the object, at a height from which it may have to be lifted but not be let through things.

    Returns:
        The object with the heading, tilt and place of its rest, or None if it finds none near.

    Raises:
        SpecError: MuJoCo cannot compile the two.
    """
    alone = {"parent": None, "parent_link": None, "environment": True, "xy": (0.0, 0.0)}
    base = parent.model_copy(update={**alone, "z": 0.0, "yaw": 0.0})
    scene = SceneSpec(name="rest", objects=(base, item))
    try:
        model = to_mjspec(scene, timestep=TIMESTEP_S).compile()
    except ValueError as error:
        raise SpecError(f"{item.name} on {parent.name}: {error}") from None
    root = model.body(item.name)
    mine = model.jnt_dofadr[int(root.jntadr[0])] + np.arange(6)
    size = float(np.linalg.norm(np.subtract(*bounds(item.spec, item.joint_state, item.base_tilt))))
    drag = float(root.subtreemass[0]) * float(np.linalg.norm(scene.gravity)) / FALL_M_S
    model.dof_damping[:] = HEAVY * drag  # joints stay as they were seen
    model.dof_damping[mine] = np.repeat([drag, drag * (size / 2) ** 2], 3)
    data = mujoco.MjData(model)
    if not _lifted(model, data, root.id, size):
        return None
    speed = np.inf
    for _ in range(round(LONGEST_S / CHECKED_S)):
        mujoco.mj_step(model, data, round(CHECKED_S / TIMESTEP_S))
        speed = float((np.abs(data.qvel[mine]) * np.repeat([1.0, size / 2], 3)).max())
        if speed < STILL_M_S:
            break
    if not speed < CREEP_M_S:
        return None
    at = world_poses(scene)
    frame = support_frame(base, at[base.name], item.parent_link)
    end = frame.inverse().then(pose(data.body(item.name).xpos, data.body(item.name).xquat))
    heading = yaw_of(quat_mul(end.quat, conjugate(frame.inverse().then(at[item.name]).quat)))
    tilt = quat_mul(conjugate(from_yaw(item.yaw + heading)), end.quat)
    far = float(np.linalg.norm(end.pos[:2] - np.array(item.xy)))
    if angle_between(item.base_tilt, tilt) > MOST_RAD or far > ASIDE * size:
        return None
    return item.model_copy(
        update={
            "xy": tuple(end.pos[:2].tolist()),
            "z": float(end.pos[2]),
            "yaw": item.yaw + heading,
            "base_tilt": tuple((tilt / np.linalg.norm(tilt)).tolist()),
        }
    )


def _lifted(model: mujoco.MjModel, data: mujoco.MjData, body: int, most: float) -> bool:
    """Put the scene at its start, and lift a free body until it is in nothing else."""
    mujoco.mj_resetDataKeyframe(model, data, 0)
    height = int(model.jnt_qposadr[model.body_jntadr[body]]) + 2
    tree = model.body_rootid[model.geom_bodyid]
    for _ in range(round(most / LIFT_M) + 1):
        mujoco.mj_forward(model, data)
        # Parts of the parent may touch each other; that is no concern of what is laid on it.
        touches = np.count_nonzero(tree[data.contact.geom] == body, axis=1) == 1
        if not np.any(data.contact.dist[touches] < -CLEAR_M):
            return True
        data.qpos[height] += LIFT_M
    return False

"""Settle an object onto a parent that is not level, such as a spoon onto a saucer.

The search does not move tilts. An object that starts at its parsed tilt settles by some degrees in
every rollout, and that drift hides what else is wrong with a candidate.
"""

import mujoco
import numpy as np

from ..errors import SpecError
from ..physics.mjcf import to_mjspec
from ..spec import SceneObject, SceneSpec, bounds, support_frame, world_poses
from ..spec.pose import angle_between, conjugate, from_yaw, pose, quat_mul, yaw_of
from .resting_pose import MAX_TILT_RAD

FALL_M_S = 0.1
"""Terminal speed of the fall: the drag lets the object neither bounce nor slide past its rest."""
MAX_DURATION_S, TIMESTEP_S, CHECK_INTERVAL_S = 4.0, 0.002, 0.1
STILL_M_S, CREEP_M_S = 5e-4, 0.003
"""Speeds of an object's ends: below the first it rests; below the second at the end of the time its
contacts only creep, which on a slope they do for ever."""
CLEAR_M, LIFT_M = 1e-4, 0.002
MAX_SHIFT = 0.25
"""Horizontal shift over the object's diagonal beyond which it rests somewhere else."""
JOINT_DRAG = 1e6
"""Drag of joints over that of the fall: they keep their parsed positions."""


def settle(parent: SceneObject, obj: SceneObject) -> SceneObject | None:
    """Let an object come to rest on its parent alone, in a simulation with strong drag.

    Args:
        parent: its parent, which does not move.
        obj: the object; it is first lifted until it touches nothing.

    Returns:
        The object with the heading, tilt and place of its resting pose, or None if it has none
        within 30 degrees and a quarter of its size.

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
    data = mujoco.MjData(model)
    if not _lifted(model, data, root.id, size):
        return None
    speed = np.inf
    for _ in range(round(MAX_DURATION_S / CHECK_INTERVAL_S)):
        mujoco.mj_step(model, data, round(CHECK_INTERVAL_S / TIMESTEP_S))
        speed = float((np.abs(data.qvel[dofs]) * np.repeat([1.0, size / 2], 3)).max())
        if speed < STILL_M_S:
            break
    if not speed < CREEP_M_S:
        return None
    at = world_poses(scene)
    frame = support_frame(base, at[base.name], obj.parent_link)
    end = frame.inverse().then(pose(data.body(obj.name).xpos, data.body(obj.name).xquat))
    heading = yaw_of(quat_mul(end.quat, conjugate(frame.inverse().then(at[obj.name]).quat)))
    tilt = quat_mul(conjugate(from_yaw(obj.yaw + heading)), end.quat)
    shift = float(np.linalg.norm(end.pos[:2] - np.array(obj.xy)))
    if angle_between(obj.base_tilt, tilt) > MAX_TILT_RAD or shift > MAX_SHIFT * size:
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
    """Put the scene at its start, and lift a free body until it is in nothing else."""
    mujoco.mj_resetDataKeyframe(model, data, 0)
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

"""Settling of objects under drag, which limits their speed, so that they neither bounce nor roll.

`settle` settles populations on any engine, `at_rest` a single scene in C MuJoCo.
"""

import copy
import dataclasses
import math
import weakref
from collections.abc import Mapping, Sequence

import jax
import mujoco
import numpy as np

from ..spec import SceneObject, SceneSpec, support_frame, world_poses
from ..spec.pose import Pose, angle_between, conjugate, from_yaw, pose, quat_mul, yaw_of
from .engine import EarlyStop, Engine, RolloutStatus
from .exact import start_state
from .layout import Poses
from .model import FREE, SceneModel, StaticScene

FALL_M_S = 0.15
"""Terminal speed with drag [m/s]."""
REACH_M = 0.05
"""Characteristic length of rotational drag, relative to translational drag, in `at_rest` [m]."""
HEADING = 100.0
"""Drag of rotation about the vertical, relative to that about other axes, so that an object pushed
aside keeps its heading in the photograph."""
JOINT_DRAG = 1e6
"""Drag of joints relative to that of falling, in populations, so that they keep their positions."""
COARSER = 2
"""Factor by which the time step is longer when populations settle, as all speeds are low."""
LEVEL_DEG = 0.3
"""Tilt below which an object counts as upright [deg]."""
SETTLING_STOP = EarlyStop(
    distance=0.0067, angle=0.058, drift=1e3, tilt=1e3, linger=0.12, anywhere=True
)
"""Early stopping of settling: objects rest wherever they are, and may quiver within 1 mm and half a
degree.
"""


def settle(scene: SceneModel, poses: Poses, engine: Engine, duration: float) -> Poses:
    """Settle placed candidates under drag.

    Joints keep their positions. A candidate that fails keeps its placed poses.

    Args:
        scene: the compiled scene.
        poses: placed poses of the candidates' objects.
        engine: the engine.
        duration: simulated time [s].

    Returns:
        Settled poses, on the host; `height` is that of the placed poses.
    """
    rollout = jax.device_get(
        engine.rollout(
            with_drag(scene),
            poses,
            duration=duration,
            record_every=duration,
            early_stop=SETTLING_STOP,
        )
    )
    failed = np.isin(rollout.status, (int(RolloutStatus.FAILED), int(RolloutStatus.TRUNCATED)))
    start: Poses = jax.tree.map(np.asarray, poses)
    unsettled = failed[:, None, None]
    return Poses(
        np.where(unsettled, start.pos, rollout.pos[:, -1]),
        np.where(unsettled, start.quat, rollout.quat[:, -1]),
        start.scale,
        start.height,
    )


def with_drag(scene: SceneModel) -> SceneModel:
    """Return a scene with drag that limits the speed of free objects to FALL_M_S and holds joints.

    Drag is proportional to an object's weight at any scale. The time step is COARSER times longer.
    """
    known = _dragged.get(scene.static)
    if known is None:
        known = _dragged[scene.static] = _static_with_drag(scene.static)
    return dataclasses.replace(scene, static=known)


_dragged: "weakref.WeakKeyDictionary[StaticScene, StaticScene]" = weakref.WeakKeyDictionary()


def _static_with_drag(static: StaticScene) -> StaticScene:
    model = copy.copy(static.mjm)
    model.opt.timestep *= COARSER
    drag = _drag(model, static.characteristic_length)
    of_free = model.jnt_type[model.dof_jntid] == FREE
    model.dof_damping[:] = np.where(of_free, drag, JOINT_DRAG * drag)
    turning = of_free & (np.arange(model.nv) - model.jnt_dofadr[model.dof_jntid] >= 3)
    mass = static.powers.body_mass[model.body_rootid[model.dof_bodyid]]
    model.dof_damping[_heading_dofs(model, static.start)] *= HEADING
    power = mass + np.where(turning, 2.0, 0.0)
    powers = static.powers._replace(dof_damping=power)
    return dataclasses.replace(static, mjm=model, powers=powers)


def _drag(model: mujoco.MjModel, length: np.ndarray) -> np.ndarray:
    """Return the damping of each dof at which its object falls at FALL_M_S."""
    weight = model.body_subtreemass[model.body_rootid[model.dof_bodyid]]
    gravity = float(np.linalg.norm(model.opt.gravity))
    return weight * gravity / FALL_M_S * length**2


def _heading_dofs(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Return the rotational dof of each free object whose axis is nearest to the vertical."""
    free = np.flatnonzero(model.jnt_type == FREE)
    w, x, y, z = qpos[model.jnt_qposadr[free][:, None] + np.arange(3, 7)].T
    vertical = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    return model.jnt_dofadr[free] + 3 + np.abs(vertical).argmax(axis=1)


def at_rest(
    scene: SceneSpec, phases: Sequence[tuple[bool, float]], *, sleeps: bool = False
) -> SceneSpec:
    """Return a scene with every movable object at its settled pose.

    Args:
        scene: the scene; joints move, but their stored values do not change.
        phases: consecutive phases, each a flag, True for drag, and a duration [s].
        sleeps: True lets objects at rest sleep until the next phase or contact.
    """
    model, data = start_state(scene)
    if sleeps:
        model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    plain, drag = model.dof_damping.copy(), model.dof_damping.copy()
    for item in scene.objects:
        if not item.static:
            body = model.body(item.name)
            weight = float(body.subtreemass[0]) * float(np.linalg.norm(scene.gravity)) / FALL_M_S
            dofs = model.jnt_dofadr[int(body.jntadr[0])] + np.arange(6)
            drag[dofs] = np.repeat([weight, weight * REACH_M**2], 3)
    drag[_heading_dofs(model, data.qpos)] *= HEADING
    for dragging, seconds in phases:
        if sleeps:
            data = _awake(model, data)
        model.dof_damping[:] = drag if dragging else plain
        mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    mujoco.mj_forward(model, data)
    ends = {
        item.name: pose(data.body(item.name).xpos.copy(), data.body(item.name).xquat.copy())
        for item in scene.objects
        if not item.static
    }
    return moved(scene, ends)


def _awake(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Return new data in the same state, without sleeping trees."""
    new = mujoco.MjData(model)
    new.qpos[:], new.qvel[:] = data.qpos, data.qvel
    return new


def moved(scene: SceneSpec, ends: Mapping[str, Pose]) -> SceneSpec:
    """Return a scene with new world poses of some objects; the others move with their parents."""
    starts = world_poses(scene)
    placed = dict(starts)
    objects: list[SceneObject] = []
    for item in scene.objects:
        frame, before = pose(), pose()
        if item.parent is not None:
            parent = scene.object(item.parent)
            frame = support_frame(parent, placed[item.parent], item.parent_link)
            before = support_frame(parent, starts[item.parent], item.parent_link)
        end = ends.get(item.name, frame.then(before.inverse().then(starts[item.name])))
        placed[item.name] = end
        objects.append(_placed(item, frame.inverse().then(end)) if item.name in ends else item)
    return scene.model_copy(update={"objects": tuple(objects)})


def _placed(item: SceneObject, at: Pose) -> SceneObject:
    """Return an object at a pose in its parent's frame, split into a tilt followed by a yaw."""
    turn = yaw_of(quat_mul(at.quat, conjugate(quat_mul(from_yaw(item.yaw), item.base_tilt))))
    yaw = math.remainder(item.yaw + turn, 2 * math.pi)
    tilt = quat_mul(conjugate(from_yaw(yaw)), at.quat)
    tilt = tilt / np.linalg.norm(tilt) * (1.0 if tilt[0] >= 0 else -1.0)
    if math.degrees(angle_between(np.array([1.0, 0.0, 0.0, 0.0]), tilt)) < LEVEL_DEG:
        tilt = np.array([1.0, 0.0, 0.0, 0.0])
    return item.model_copy(
        update={
            "xy": tuple(at.pos[:2].tolist()),
            "z": float(at.pos[2]),
            "yaw": yaw,
            "base_tilt": tuple(tilt.tolist()),
        }
    )

"""Where the things of a scene come to rest when gravity alone moves them."""

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from ...physics.exact import start_state
from ...spec import SceneObject, SceneSpec, support_frame, world_poses
from ...spec.pose import Pose, angle_between, conjugate, from_yaw, pose, quat_mul, yaw_of

FALL_M_S = 0.15
"""Terminal speed where there is drag: things sink instead of falling."""
REACH_M = 0.05
"""Length by which drag on turning follows from that on sinking."""
LEVEL_DEG = 0.3
"""Tilt below which an object counts as upright."""


def at_rest(scene: SceneSpec, phases: Sequence[tuple[bool, float]]) -> SceneSpec:
    """Return a scene with every movable object where it comes to rest.

    Args:
        scene: the scene; joints move, but their values stay as they are written.
        phases: one after the other: whether air drags, and how long it lasts [s].
    """
    model, data = start_state(scene)
    plain, drag = model.dof_damping.copy(), model.dof_damping.copy()
    for item in scene.objects:
        if not item.static:
            body = model.body(item.name)
            weight = float(body.subtreemass[0]) * float(np.linalg.norm(scene.gravity)) / FALL_M_S
            dofs = model.jnt_dofadr[int(body.jntadr[0])] + np.arange(6)
            drag[dofs] = np.repeat([weight, weight * REACH_M**2], 3)
    for dragging, seconds in phases:
        model.dof_damping[:] = drag if dragging else plain
        mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    mujoco.mj_forward(model, data)
    ends = {
        item.name: pose(data.body(item.name).xpos.copy(), data.body(item.name).xquat.copy())
        for item in scene.objects
        if not item.static
    }
    return moved(scene, ends)


def moved(scene: SceneSpec, ends: Mapping[str, Pose]) -> SceneSpec:
    """Return a scene with objects at other poses in the world; the others go with their parents."""
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
    """Return an object at a pose in its parent's frame: yaw, and the tilt before it."""
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

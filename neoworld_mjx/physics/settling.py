"""Settling under guidance, for candidates on any engine and for a single scene in C MuJoCo.

Springs that fade (`guidance`) hold the objects near their placed poses while the objects settle on
whatever they touch. Joints keep their positions.
"""

import copy
import dataclasses
import math
import weakref
from collections.abc import Mapping

import jax
import mujoco
import numpy as np

from ..config import SettleOptions
from ..spec import SceneObject, SceneSpec, support_frame, world_poses
from ..spec.pose import Pose, conjugate, from_yaw, pose, quat_mul, yaw_of
from .colliders import start_state
from .engine import EarlyStop, Engine, RolloutStatus
from .guidance import INTERVAL_S, Guidance, GuidedBodies, free_bodies, springs
from .layout import Poses
from .model import FREE, SceneModel, StaticScene, is_rotational
from .recorder import DIVERGED

HOLD_RATE = 1e5
"""Damping of joints while objects settle, divided by the joint's inertia [1/s]. If gravity
accelerates a joint by a, the joint moves with velocity a / HOLD_RATE."""


def guidance(o: SettleOptions) -> Guidance:
    """Return the springs that the options describe."""
    return Guidance(o.rate, o.fade_s)


def settle(scene: SceneModel, poses: Poses, engine: Engine, o: SettleOptions) -> Poses:
    """Settle placed candidates under guidance.

    A candidate whose simulation fails keeps its placed poses.

    Args:
        scene: the compiled scene.
        poses: placed poses of the candidates' objects.
        engine: the engine.
        o: duration, springs and speed limit.

    Returns:
        Settled poses, on the host. `height` is the height of the placed poses.
    """
    rollout = jax.device_get(
        engine.rollout(
            with_damped_joints(scene),
            poses,
            duration=o.duration_s,
            record_every=o.duration_s,
            early_stop=EarlyStop(
                after=o.fade_s, distance=0.0067, angle=0.058, drift=1e3, tilt=1e3, linger=0.12,
                anywhere=True,
            ),
            guidance=guidance(o),
        )
    )  # fmt: skip
    failed = np.isin(rollout.status, (int(RolloutStatus.FAILED), int(RolloutStatus.TRUNCATED)))
    start: Poses = jax.tree.map(np.asarray, poses)
    unsettled = failed[:, None, None]
    return Poses(
        np.where(unsettled, start.pos, rollout.pos[:, -1]),
        np.where(unsettled, start.quat, rollout.quat[:, -1]),
        start.scale,
        start.height,
    )


def with_damped_joints(scene: SceneModel) -> SceneModel:
    """Return a scene in which damping keeps all joints in place, at any scale of the objects."""
    if not len(scene.static.joints):
        return scene
    damped = _damped_joints.get(scene.static)
    if damped is None:
        damped = _damped_joints[scene.static] = _static_with_damped_joints(scene.static)
    return dataclasses.replace(scene, static=damped)


_damped_joints: "weakref.WeakKeyDictionary[StaticScene, StaticScene]" = weakref.WeakKeyDictionary()


def _static_with_damped_joints(static: StaticScene) -> StaticScene:
    model = copy.copy(static.mjm)
    damp_joints(model)
    of_joint = model.jnt_type[model.dof_jntid] != FREE
    rotational = np.array([is_rotational(model, dof) for dof in range(model.nv)])
    mass = static.powers.body_mass[model.dof_bodyid]
    power = np.where(of_joint, mass + np.where(rotational, 2.0, 0.0), static.powers.dof_damping)
    powers = static.powers._replace(dof_damping=power)
    return dataclasses.replace(static, mjm=model, powers=powers)


def damp_joints(model: mujoco.MjModel) -> None:
    """Set the damping of all joints except free joints so high that the joints stay in place."""
    of_joint = model.jnt_type[model.dof_jntid] != FREE
    model.dof_damping[of_joint] = HOLD_RATE * model.dof_M0[of_joint]


def settle_scene(scene: SceneSpec, o: SettleOptions) -> SceneSpec:
    """Return a scene whose movable objects have settled under guidance in C MuJoCo.

    If the simulation diverges, return the scene unchanged.

    Args:
        scene: the scene. Joints keep their positions.
        o: duration, springs and speed limit.
    """
    model, data = start_state(scene)
    timestep = float(model.opt.timestep)
    if not model.nv:
        return scene
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    damp_joints(model)
    bodies = free_bodies(model, data.qpos)
    guided = GuidedBodies(bodies, springs(bodies, data.qpos[bodies.qpos]))
    spring_options, every = guidance(o), max(1, round(INTERVAL_S / timestep))
    for step in range(0, max(1, round(o.duration_s / timestep)), every):
        data.qfrc_applied[:], data.qvel[:] = guided.push(
            spring_options, step * timestep, data.qpos, data.qvel
        )
        mujoco.mj_step(model, data, every)
        if not np.all(np.abs(data.qpos) < DIVERGED):
            return scene
    return at_state(scene, model, data)


def at_state(scene: SceneSpec, model: mujoco.MjModel, data: mujoco.MjData) -> SceneSpec:
    """Return a scene with the poses of its movable objects in a simulation."""
    mujoco.mj_forward(model, data)
    names = [item.name for item in scene.objects if not item.static]
    bodies = [data.body(name) for name in names]
    return with_world_poses(
        scene,
        {n: pose(b.xpos.copy(), b.xquat.copy()) for n, b in zip(names, bodies, strict=True)},
    )


def with_world_poses(scene: SceneSpec, ends: Mapping[str, Pose]) -> SceneSpec:
    """Return a scene with new world poses of some objects. All others move with their parents."""
    old_poses = world_poses(scene)
    new_poses = dict(old_poses)
    objects: list[SceneObject] = []
    for item in scene.objects:
        frame, before = pose(), pose()
        if item.parent is not None:
            parent = scene.object(item.parent)
            frame = support_frame(parent, new_poses[item.parent], item.parent_link)
            before = support_frame(parent, old_poses[item.parent], item.parent_link)
        end = ends.get(item.name, frame.then(before.inverse().then(old_poses[item.name])))
        new_poses[item.name] = end
        objects.append(
            _with_support_pose(item, frame.inverse().then(end)) if item.name in ends else item
        )
    return scene.model_copy(update={"objects": tuple(objects)})


def _with_support_pose(item: SceneObject, rest: Pose) -> SceneObject:
    """Return an object at a pose in its support frame, split into a tilt followed by a yaw."""
    turn = yaw_of(quat_mul(rest.quat, conjugate(quat_mul(from_yaw(item.yaw), item.base_tilt))))
    yaw = math.remainder(item.yaw + turn, 2 * math.pi)
    tilt = quat_mul(conjugate(from_yaw(yaw)), rest.quat)
    tilt = tilt / np.linalg.norm(tilt) * (1.0 if tilt[0] >= 0 else -1.0)
    return item.model_copy(
        update={
            "xy": tuple(rest.pos[:2].tolist()),
            "z": float(rest.pos[2]),
            "yaw": yaw,
            "base_tilt": tuple(tilt.tolist()),
        }
    )

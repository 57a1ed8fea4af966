"""S-Pen and S-Stab, the physical measures of the paper's scene table, computed by C MuJoCo."""

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray
from pydantic import Field

from ..physics.exact import object_depths, start_state
from ..spec import SceneSpec, Spec
from ..spec.pose import angle_between


class SceneMeasure(Spec):
    """Penetration and stability of a scene."""

    objects: int
    movable: int
    """Number of objects with a free base. If there are none, stability is undefined."""
    s_pen: int | None
    """1 if two objects penetrate deeper than the bound in the composed pose, else 0."""
    max_depth_m: float
    """Largest penetration depth of two objects in the composed pose."""
    settled_depth_m: float
    """Largest penetration depth at the end of the simulation, when contacts bear weight."""
    depths_m: dict[str, float] = Field(default_factory=dict)
    """Penetration depth of each penetrating pair "a|b" in the composed pose."""
    settled_depths_m: dict[str, float] = Field(default_factory=dict)
    """Penetration depth of each penetrating pair "a|b" at the end of the simulation."""
    s_stab: bool | None
    """True if every object stayed within the bounds at all times; None without movable objects."""
    max_drift_m: float
    max_tilt_deg: float
    drift_m: dict[str, float] = Field(default_factory=dict)
    tilt_deg: dict[str, float] = Field(default_factory=dict)
    drop_m: dict[str, float] = Field(default_factory=dict)
    """Largest descent of each movable object."""
    joint_slide_m: dict[str, float] = Field(default_factory=dict)
    """Largest displacement of each sliding joint "object-joint"."""
    joint_turn_deg: dict[str, float] = Field(default_factory=dict)
    """Largest rotation of each turning joint "object-joint"."""
    duration_s: float
    diverged: bool = False
    displacement: dict[str, float] | None = None
    """Displacement of each movable object by settling from the pose at which it was placed,
    relative to its limit (`physics.placed.settling_displacement`); None for a scene that was
    measured as it is."""


def scene_measure(
    scene: SceneSpec,
    *,
    duration: float = 2.0,
    timestep: float = 0.002,
    max_depth: float = 1e-3,
    max_drift: float = 0.01,
    max_tilt: float = 5.0,
    sleeps: bool = False,
) -> SceneMeasure:
    """Measure penetration in the composed pose, and drift in a simulation that starts from it.

    The simulation has no drag. The poses after every step are compared with the composed pose.
    Stepping releases the GIL, so several scenes may be measured in threads.

    Args:
        scene: the scene.
        duration: simulated time [s].
        timestep: time step [s].
        max_depth: penetration bound [m].
        max_drift: translation bound [m].
        max_tilt: rotation bound [deg].
        sleeps: if True, let islands of bodies at rest sleep (`mjENBL_SLEEP`). This is faster, but
            it is not the paper's measure.
    """
    model, data = start_state(scene, timestep)
    if sleeps:
        model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    initial_depths = object_depths(scene, model, data)
    names = [obj.name for obj in scene.objects if not obj.static]
    base = np.array([model.jnt_qposadr[model.body(name).jntadr[0]] for name in names], int)
    base = base[:, None] + np.arange(7)
    initial = data.qpos.copy()
    start = initial[base]
    qpos, finite = _simulate(model, data, round(duration / timestep))
    poses = qpos[:, base]
    shift = np.linalg.norm(poses[..., :3] - start[:, :3], axis=-1).max(axis=0, initial=0.0)
    tilt = np.degrees(angle_between(start[:, 3:], poses[..., 3:])).max(axis=0, initial=0.0)
    drop = (start[:, 2] - poses[..., 2]).max(axis=0, initial=0.0)
    slide, turn = _joint_motion(model, initial, qpos)
    diverged = not (finite and np.isfinite(shift).all())
    final_depths = {} if diverged else object_depths(scene, model, data)
    stable = not diverged and bool(np.all(shift < max_drift) and np.all(tilt < max_tilt))
    deepest = max(initial_depths.values(), default=0.0)
    return SceneMeasure(
        objects=len(scene.objects),
        movable=len(names),
        s_pen=int(deepest > max_depth),
        max_depth_m=deepest,
        settled_depth_m=max(final_depths.values(), default=0.0),
        depths_m={f"{a}|{b}": depth for (a, b), depth in initial_depths.items()},
        settled_depths_m={f"{a}|{b}": depth for (a, b), depth in final_depths.items()},
        s_stab=stable if names else None,
        max_drift_m=float(shift.max(initial=0.0)) if not diverged else float("inf"),
        max_tilt_deg=float(tilt.max(initial=0.0)) if not diverged else float("inf"),
        drift_m=dict(zip(names, shift.tolist(), strict=True)),
        tilt_deg=dict(zip(names, tilt.tolist(), strict=True)),
        drop_m=dict(zip(names, drop.tolist(), strict=True)),
        joint_slide_m=slide,
        joint_turn_deg=turn,
        duration_s=duration,
        diverged=diverged,
    )


def _joint_motion(
    model: mujoco.MjModel, start: NDArray[np.float64], qpos: NDArray[np.float64]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the largest motion of each sliding joint [m] and of each turning joint [deg]."""
    slide, turn = {}, {}
    for k in range(model.njnt):
        kind, address, name = model.jnt_type[k], model.jnt_qposadr[k], model.joint(k).name
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            continue
        if kind == mujoco.mjtJoint.mjJNT_BALL:
            quat = slice(address, address + 4)
            angle = angle_between(start[quat], qpos[:, quat])
            turn[name] = float(np.degrees(angle).max(initial=0.0))
            continue
        motion = float(np.abs(qpos[:, address] - start[address]).max(initial=0.0))
        if kind == mujoco.mjtJoint.mjJNT_SLIDE:
            slide[name] = motion
        else:
            turn[name] = float(np.degrees(motion))
    return slide, turn


def _simulate(
    model: mujoco.MjModel, data: mujoco.MjData, steps: int
) -> tuple[NDArray[np.float64], bool]:
    """Simulate a scene from the state in `data`, in one call to MuJoCo.

    Returns:
        qpos after each step, shape [step, nq]; and True if the simulation stayed finite. If it did,
        `data` is set to the last state.
    """
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    states, _ = rollout.rollout(model, data, initial_state=state[None], nstep=steps)
    states = np.asarray(states).reshape(steps, -1)
    w = mujoco.mjtWarning
    bad = (w.mjWARN_BADQPOS, w.mjWARN_BADQVEL, w.mjWARN_BADQACC)
    finite = bool(np.isfinite(states).all()) and not any(data.warning[k].number for k in bad)
    if finite:
        mujoco.mj_setState(model, data, states[-1], kind)
        mujoco.mj_forward(model, data)
    return states[:, 1 : 1 + model.nq], finite

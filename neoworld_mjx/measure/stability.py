"""S-Pen and S-Stab of one scene (the physical measures of the paper's scene table), by C MuJoCo
alone.
"""

import mujoco
import numpy as np
from pydantic import Field

from ..physics.exact import object_depths, start_state
from ..spec import SceneSpec, Spec
from ..spec.pose import angle_between


class SceneMeasure(Spec):
    """Penetration and stability of a scene."""

    objects: int
    movable: int
    """Objects with a free base; without any there is no stability to speak of."""
    s_pen: int | None
    """1 if two objects are deeper than the bound in the composed pose, else 0."""
    max_depth_m: float
    """Deepest penetration of two objects in the composed pose."""
    settled_depth_m: float
    """The same at the end of the free fall, where contacts bear weight."""
    depths_m: dict[str, float] = Field(default_factory=dict)
    """Penetrating pairs, "a|b"."""
    s_stab: bool | None
    """Whether every object stayed within the bounds at all times; None without movable objects."""
    max_drift_m: float
    max_tilt_deg: float
    drift_m: dict[str, float] = Field(default_factory=dict)
    tilt_deg: dict[str, float] = Field(default_factory=dict)
    duration_s: float
    diverged: bool = False


def scene_measure(
    scene: SceneSpec,
    *,
    duration: float = 2.0,
    timestep: float = 0.002,
    max_depth: float = 1e-3,
    max_drift: float = 0.01,
    max_tilt: float = 5.0,
) -> SceneMeasure:
    """Measure penetration in the composed pose and drift over a free fall from it.

    No damping is added beyond what joints have; poses are compared after every step.

    Args:
        scene: the scene.
        duration: simulated time [s].
        timestep: [s].
        max_depth: penetration bound [m].
        max_drift: translation bound [m].
        max_tilt: rotation bound [deg].
    """
    model, data = start_state(scene, timestep)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    at_start = object_depths(scene, model, data)
    names = [item.name for item in scene.objects if not item.static]
    bodies = [model.body(name).id for name in names]
    pos0, quat0 = data.xpos[bodies].copy(), data.xquat[bodies].copy()
    shift, tilt = np.zeros(len(names)), np.zeros(len(names))
    for _ in range(round(duration / timestep)):
        mujoco.mj_step(model, data)
        pos, quat = data.xpos[bodies], data.xquat[bodies]
        shift = np.maximum(shift, np.linalg.norm(pos - pos0, axis=1))
        tilt = np.maximum(tilt, np.degrees(angle_between(quat0, quat)))
    diverged = not (np.isfinite(shift).all() and np.isfinite(data.qpos).all())
    at_end = {} if diverged else object_depths(scene, model, data)
    stable = not diverged and bool(np.all(shift < max_drift) and np.all(tilt < max_tilt))
    deepest = max(at_start.values(), default=0.0)
    return SceneMeasure(
        objects=len(scene.objects),
        movable=len(names),
        s_pen=int(deepest > max_depth),
        max_depth_m=deepest,
        settled_depth_m=max(at_end.values(), default=0.0),
        depths_m={f"{a}|{b}": depth for (a, b), depth in at_start.items()},
        s_stab=stable if names else None,
        max_drift_m=float(shift.max(initial=0.0)) if not diverged else float("inf"),
        max_tilt_deg=float(tilt.max(initial=0.0)) if not diverged else float("inf"),
        drift_m=dict(zip(names, shift.tolist(), strict=True)),
        tilt_deg=dict(zip(names, tilt.tolist(), strict=True)),
        duration_s=duration,
        diverged=diverged,
    )

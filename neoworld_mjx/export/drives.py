"""Drives: critically damped position actuators for the joints of a scene, which environments add.

Exported scenes have none, because drives resist motion: without them, a gripper can pull a drawer
open by the drawer's handle.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from ..physics.mjcf import start_data, to_mjspec
from ..spec import ObjectSpec, SceneSpec

RATE = 20.0
"""Natural frequency of a critically damped drive [rad/s]."""


@dataclass(frozen=True)
class Drive:
    """Critically damped position actuator of a joint, or of one axis of a ball joint."""

    name: str
    """Name of the joint in the model, followed by -x, -y or -z for an axis of a ball joint."""
    joint: str
    """Name of the joint in the model."""
    axis: str
    """x, y or z for a ball joint, otherwise empty."""
    stiffness: float
    """Stiffness [N m/rad or N/m]."""
    damping: float
    """Damping [N m s/rad or N s/m]."""
    range: tuple[float, float] | None
    """Range of targets [rad or m]; None if unlimited."""
    effort: float | None
    """Maximum torque or force [N m or N]; None if unlimited."""
    target: float
    """Target that holds the joint at its position in the scene [rad or m]."""


def drives(scene: SceneSpec | ObjectSpec) -> tuple[Drive, ...]:
    """Return the drives of all joints: three for a ball joint, none for a fixed or mimic joint."""
    if isinstance(scene, SceneSpec):
        objects = [(item.name, item.spec) for item in scene.objects]
    else:
        objects = [(scene.name, scene)]
    driven = [
        (f"{owner}-{joint.name}", joint, axis)
        for owner, spec in objects
        for joint in spec.joints
        if joint.type != "fixed" and joint.mimic is None
        for axis in ("xyz" if joint.type == "ball" else [""])
    ]
    if not driven:
        return ()
    model = to_mjspec(scene).compile()
    data = start_data(model)
    result = []
    for name, joint, axis in driven:
        dof = model.joint(name).dofadr[0] + max("xyz".find(axis), 0)
        inertia = float(model.dof_M0[dof])
        limited = joint.type in ("revolute", "prismatic")
        result.append(
            Drive(
                name=name + (f"-{axis}" if axis else ""),
                joint=name,
                axis=axis,
                stiffness=rounded(inertia * RATE**2),
                damping=rounded(2 * inertia * RATE),
                range=(joint.lower, joint.upper) if limited else None,
                effort=joint.effort,
                target=_target(data.joint(name).qpos, axis),
            )
        )
    return tuple(result)


def _target(qpos: np.ndarray, axis: str) -> float:
    """Return the target that holds a joint, or one axis of a ball joint, at its position."""
    if not axis:
        return float(qpos[0])
    vector = np.zeros(3)
    mujoco.mju_quat2Vel(vector, qpos, 1.0)
    return float(vector["xyz".find(axis)])


def rounded(value: float) -> float:
    """Round a value to 4 significant digits."""
    return float(f"{value:.4g}")

"""Writes drives.xml, an MJCF file that includes a scene or an object and adds position actuators.

The actuators are in a separate file because they resist motion. Without actuators, a gripper can
pull a drawer open by the drawer's handle.
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import mujoco
import numpy as np

from ..physics.mjcf import START, to_mjspec
from ..spec import ObjectSpec, SceneSpec
from .write_glb import numbers

RATE = 20.0
"""Natural frequency of a critically damped drive [rad/s]."""
GROUP = 1
"""Actuator group of the drives; <option actuatorgroupdisable="1"/> disables them."""


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
    model, data = _posed(scene)
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
                stiffness=round_to(inertia * RATE**2, 4),
                damping=round_to(2 * inertia * RATE, 4),
                range=(joint.lower, joint.upper) if limited else None,
                effort=joint.effort,
                target=_target(data.joint(name).qpos, axis),
            )
        )
    return tuple(result)


def drives_text(scene: SceneSpec | ObjectSpec, file: str) -> str | None:
    """Return MJCF that includes a file and adds position actuators; None if there are no drives.

    The keyframe "held" contains the state of the scene and the targets that hold this state.

    Args:
        scene: the scene or object in the included file.
        file: name of the included file.
    """
    all_drives = drives(scene)
    if not all_drives:
        return None
    root = ET.Element("mujoco", model=scene.name)
    ET.SubElement(root, "include", file=file)
    defaults = ET.SubElement(ET.SubElement(root, "default"), "default", {"class": "drives"})
    ET.SubElement(defaults, "position", group=str(GROUP))
    actuators = ET.SubElement(root, "actuator")
    for drive in all_drives:
        _add_drive(actuators, drive)
    keys = ET.SubElement(root, "keyframe")
    _, data = _posed(scene)
    targets = numbers([drive.target for drive in all_drives])
    ET.SubElement(keys, "key", name="held", qpos=numbers(data.qpos), ctrl=targets)
    ET.indent(root, " ")
    return ET.tostring(root, encoding="unicode") + "\n"


def _posed(scene: SceneSpec | ObjectSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = to_mjspec(scene).compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(START).id)
    return model, data


def _add_drive(actuators: ET.Element, drive: Drive) -> None:
    fields = {
        "class": "drives",
        "name": drive.name,
        "joint": drive.joint,
        "kp": numbers([drive.stiffness]),
        "kv": numbers([drive.damping]),
    }
    if drive.axis:
        fields["gear"] = " ".join(str(int(drive.axis == a)) for a in "xyz") + " 0 0 0"
    elif drive.range is not None:
        fields["ctrlrange"] = numbers(drive.range)
    if drive.effort is not None:
        fields["forcerange"] = numbers([-drive.effort, drive.effort])
    ET.SubElement(actuators, "position", fields)


def _target(qpos: np.ndarray, axis: str) -> float:
    """Return the target that holds a joint, or one axis of a ball joint, at its position."""
    if not axis:
        return float(qpos[0])
    vector = np.zeros(3)
    mujoco.mju_quat2Vel(vector, qpos, 1.0)
    return float(vector["xyz".find(axis)])


def round_to(value: float, digits: int) -> float:
    """Round a value to `digits` significant digits."""
    return float(f"{value:.{digits}g}")

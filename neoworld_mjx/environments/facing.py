"""Initial pose of a gripper in front of a handle, with one finger on each side of the handle."""

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError, choices
from ..export.link_frames import Frame, frames
from ..physics.gripper import OPENING_M, Gripper
from ..spec import SceneObject, SceneSpec, link_poses, world_poses
from ..spec.pose import from_matrix, rotate

AWAY_M = 0.10
"""Initial distance of a gripper from a handle [m]."""


def handles(scene: SceneSpec) -> dict[str, tuple[SceneObject, Frame]]:
    """Return the object and the frame of each handle of a scene, by name <object>-<frame>."""
    return {
        f"{item.name}-{frame.name}": (item, frame)
        for item in scene.objects
        for frame in frames(item.spec)
        if frame.joint is not None
    }


def facing(scene: SceneSpec, name: str) -> Gripper:
    """Return a gripper in front of a handle that points against the handle's opening direction.

    Raises:
        SpecError: the scene has no handle with this name.
    """
    by_name = handles(scene)
    if name not in by_name:
        raise SpecError(f"scene {scene.name}: handle: {choices(name, sorted(by_name))}")
    item, frame = by_name[name]
    assert frame.joint is not None and frame.half is not None
    world = world_poses(scene)[item.name].then(link_poses(item.spec, item.joint_state)[frame.part])
    point = world.apply(frame.pos)
    joint = item.spec.joint(frame.joint)
    opens = np.array(joint.axis)
    if joint.type != "prismatic":
        opens = np.cross(opens, np.array(frame.pos) - np.array(joint.pos))
        if np.linalg.norm(opens) < 1e-6:
            opens = np.array(joint.axis)
    opens = opens / np.linalg.norm(opens)
    across = _across(opens, np.array(frame.half))
    local_axes = np.column_stack([np.cross(across, -opens), across, -opens])
    axes = np.column_stack([rotate(world.quat, column) for column in local_axes.T])
    start = point + AWAY_M * rotate(world.quat, opens)
    x, y, z = (float(v) for v in start)
    w, i, j, k = (float(v) for v in from_matrix(axes))
    return Gripper((x, y, z), (w, i, j, k), OPENING_M)


def _across(opens: NDArray, half: NDArray) -> NDArray:
    """Return the unit vector normal to the opening direction along which a handle is thinnest."""
    best, thinnest = np.zeros(3), np.inf
    for k in range(3):
        axis = np.eye(3)[k] - opens[k] * opens
        length = np.linalg.norm(axis)
        if length > 0.5 and half[k] < thinnest:
            best, thinnest = axis / length, half[k]
    return best

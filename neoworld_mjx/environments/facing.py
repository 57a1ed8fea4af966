"""Where a gripper starts that is to take a handle: in front of it, fingers across it."""

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError, choices
from ..export.handles import Frame, frames
from ..physics.gripper import OPENING_M, Gripper
from ..spec import SceneObject, SceneSpec, link_poses, world_poses
from ..spec.pose import from_matrix, rotate

AWAY_M = 0.10
"""How far in front of a handle a gripper starts [m]."""


def handles(scene: SceneSpec) -> dict[str, tuple[SceneObject, Frame]]:
    """Return the handles of a scene by name, <object>-<frame>."""
    return {
        f"{item.name}-{frame.name}": (item, frame)
        for item in scene.objects
        for frame in frames(item.spec)
        if frame.joint is not None
    }


def facing(scene: SceneSpec, name: str) -> Gripper:
    """Return a gripper in front of a handle, that approaches against the way it opens.

    Raises:
        SpecError: there is no such handle.
    """
    every = handles(scene)
    if name not in every:
        raise SpecError(f"scene {scene.name}: handle: {choices(name, sorted(every))}")
    item, frame = every[name]
    assert frame.joint is not None and frame.half is not None
    at = world_poses(scene)[item.name].then(link_poses(item.spec, item.joint_state)[frame.part])
    point = at.apply(frame.pos)
    joint = item.spec.joint(frame.joint)
    opens = np.array(joint.axis)
    if joint.type != "prismatic":
        opens = np.cross(opens, np.array(frame.pos) - np.array(joint.pos))
        if np.linalg.norm(opens) < 1e-6:
            opens = np.array(joint.axis)
    opens = opens / np.linalg.norm(opens)
    across = _across(opens, np.array(frame.half))
    turn = np.column_stack([np.cross(across, -opens), across, -opens])
    world = np.column_stack([rotate(at.quat, column) for column in turn.T])
    start = point + AWAY_M * rotate(at.quat, opens)
    x, y, z = (float(v) for v in start)
    w, i, j, k = (float(v) for v in from_matrix(world))
    return Gripper((x, y, z), (w, i, j, k), OPENING_M)


def _across(opens: NDArray, half: NDArray) -> NDArray:
    """Return the direction, square to the way it opens, in which a handle is thinnest."""
    best, thinnest = np.zeros(3), np.inf
    for k in range(3):
        axis = np.eye(3)[k] - opens[k] * opens
        length = np.linalg.norm(axis)
        if length > 0.5 and half[k] < thinnest:
            best, thinnest = axis / length, half[k]
    return best

"""Displacement, scaling and rotation of objects between two scenes."""

import math
from typing import NamedTuple

import numpy as np

from ..spec import SceneSpec, bounds, world_poses
from ..spec.pose import angle_between, yaw_of


class Move(NamedTuple):
    """Displacement, scaling and rotation of one object."""

    distance_m: float
    """Distance between the object's origins in the two scenes, in the world frame."""
    size_ratio: float
    """New size divided by old size, as the geometric mean over the axes."""
    yaw_deg: float
    turn_deg: float
    """Angle between the object's orientations, including the tilt."""


def object_moves(before: SceneSpec, after: SceneSpec) -> dict[str, Move]:
    """Return the move of every object that both scenes contain, except environment supports."""
    old, new = ({item.name: item for item in scene.objects} for scene in (before, after))
    poses_before, poses_after = world_poses(before), world_poses(after)
    result = {}
    for name, item in old.items():
        if item.environment or name not in new:
            continue
        a, b = poses_before[name], poses_after[name]
        sizes = [np.subtract(*bounds(o.spec, o.joint_state)) for o in (new[name], item)]
        turn = math.remainder(yaw_of(b.quat) - yaw_of(a.quat), 2 * math.pi)
        result[name] = Move(
            float(np.linalg.norm(np.subtract(b.pos, a.pos))),
            float(np.prod(sizes[0] / sizes[1])) ** (1 / 3),
            math.degrees(turn),
            math.degrees(float(angle_between(a.quat, b.quat))),
        )
    return result

"""How far a scene's layout is from the truth, over the objects that may move."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...physics.placed import BALL
from ...spec import SceneObject, SceneSpec, bounds, world_poses
from ...spec.pose import Pose, conjugate, quat_mul, yaw_of
from ..refine_scenes import symmetry

MOST_TILT_DEG = 15.0
MOST_HEIGHT, MOST_HEIGHT_M = 0.1, 0.01
"""Bounds of `displaced`; answers' sizes alone move a middle by a few percent of its height."""


def layout_errors(scene: SceneSpec, truth: SceneSpec) -> dict[str, float]:
    """Compare a scene with the truth, over the objects that both have.

    What all objects are off by alike, their median shift, is not counted: it is that of the
    answer's camera, and no layout shows it.

    Returns:
        "xy_error_m", horizontal distance of the objects' middles; "yaw_error_deg", up to an
        object's symmetry and without round ones; "scale_error", of the logarithm. Means over the
        found objects that are no supports; what is missed or extra is for `unmatched` to count.
    """
    ends, starts = world_poses(scene), world_poses(truth)
    items = [item for item in truth.objects if not item.static and item.name in ends]
    turns, scales = [], []
    for item in items:
        other = scene.object(item.name)
        scales.append(abs(math.log(_size(other) / _size(item))))
        period = symmetry(item)
        if period > 0:
            turned = quat_mul(ends[item.name].quat, conjugate(starts[item.name].quat))
            turns.append(abs(math.remainder(yaw_of(turned), period)))
    offs = offsets(scene, truth, [item.name for item in items])
    shift = offs - np.median(offs, axis=0)
    return {
        "xy_error_m": float(np.mean(np.linalg.norm(shift, axis=1))),
        "yaw_error_deg": math.degrees(float(np.mean(turns))) if turns else 0.0,
        "scale_error": float(np.mean(scales)),
    }


def offsets(
    scene: SceneSpec, truth: SceneSpec, names: Sequence[str]
) -> Float[np.ndarray, "object 2"]:
    """Return how far the middles of objects are from the truth's, horizontally [m]."""
    ends, starts = world_poses(scene), world_poses(truth)
    middles = [
        [_middle(s.object(name), at[name]) for name in names]
        for s, at in ((scene, ends), (truth, starts))
    ]
    return (np.array(middles[0]) - np.array(middles[1])).reshape(-1, 3)[:, :2]


def unmatched(scene: SceneSpec, truth: SceneSpec) -> tuple[list[str], list[str]]:
    """Return the movable objects of the truth that a scene misses, and those that it has besides.

    No search can put them right, so they count apart, in no error and in no verdict.
    """
    real, own = ([item for item in s.objects if not item.static] for s in (truth, scene))
    names, known = {item.name for item in own}, {item.name for item in truth.objects}
    missed = [item.name for item in real if item.name not in names]
    return missed, [item.name for item in own if item.name not in known]


def displaced(scene: SceneSpec, truth: SceneSpec) -> list[str]:
    """Return the objects that a scene shows in another way than the truth: toppled or fallen down.

    Whatever has come to rest is stable, a toppled book as well; this tells the two apart. An object
    is displaced whose vertical axis is tilted by MOST_TILT_DEG from the truth's, or whose middle is
    higher or lower than the truth's by MOST_HEIGHT of its diagonal and MOST_HEIGHT_M. A ball has no
    axis. What a scene misses is not displaced, see `unmatched`, nor is what the truth has on it:
    without the one below it no layout shows it.
    """
    ends, starts = world_poses(scene), world_poses(truth)
    names, without = [], {item.name for item in truth.objects if item.name not in ends}
    for item in truth.objects:
        if item.parent in without:
            without.add(item.name)
        if item.static or item.name in without:
            continue
        end, start = ends[item.name], starts[item.name]
        up = [at.apply([0.0, 0.0, 1.0]) - at.pos for at in (end, start)]
        tilt = math.degrees(math.acos(float(np.clip(up[0] @ up[1], -1.0, 1.0))))
        tilt = 0.0 if _is_ball(item) else tilt
        rise = abs(float((_middle(scene.object(item.name), end) - _middle(item, start))[2]))
        if tilt > MOST_TILT_DEG or rise > MOST_HEIGHT * _size(item) + MOST_HEIGHT_M:
            names.append(item.name)
    return names


def _middle(item: SceneObject, at: Pose) -> Float[np.ndarray, " 3"]:
    low, high = bounds(item.spec, item.joint_state)
    return at.apply((low + high) / 2)


def _is_ball(item: SceneObject) -> bool:
    sides = np.subtract(*bounds(item.spec)[::-1])
    return symmetry(item) == 0 and float(np.ptp(sides)) < BALL * float(sides.max())


def _size(item: SceneObject) -> float:
    low, high = bounds(item.spec)
    return float(np.linalg.norm(high - low))

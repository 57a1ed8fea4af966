"""Errors of a scene's objects in the standard deviations that the estimate states."""

import math
from collections.abc import Iterator

import numpy as np

from neoworld_mjx.spec import SceneObject, SceneSpec, bounds, world_poses

from .layout_errors import heading_deg, offsets


def stated_deviations(
    scene: SceneSpec, truth: SceneSpec, *, measured: bool = False
) -> dict[str, list[float]]:
    """Return the absolute errors of objects in their stated standard deviations.

    Args:
        scene: a scene whose objects have uncertainties; those without do not count.
        truth: the ground truth, seen by a camera above the same origin.
        measured: True if a depth image or the camera's pose was given; see `object_errors`.

    Returns:
        Errors by quantity: along, across, yaw and log_scale, as in `PoseUncertainty`.
    """
    errors: dict[str, list[float]] = {}
    for quantity, value in object_errors(scene, truth, absolute=measured):
        errors.setdefault(quantity, []).append(value)
    return errors


def object_errors(
    scene: SceneSpec, truth: SceneSpec, *, absolute: bool = False
) -> Iterator[tuple[str, float]]:
    """Yield the errors of aligned objects, in their stated standard deviations.

    Positions are relative to the support, as the deviations are: a wrong field of view moves the
    whole scene along the view. Objects on walls, of another support than in the ground truth, and
    headings that symmetry makes meaningless or that are stated as not seen do not count.

    Args:
        scene: the aligned scene.
        truth: the ground truth, seen by a camera above the same origin.
        absolute: if True, positions on fixed supports are those in the world. A depth image, or a
            known camera, measures objects, and not where a table ends.
    """
    ends, begins = world_poses(scene), world_poses(truth)
    true = {item.name: item for item in truth.objects}
    names = [item.name for item in scene.objects if item.name in true]
    offset = dict(zip(names, offsets(scene, truth, names), strict=True))
    for item in scene.objects:
        known, same = item.uncertainty, true.get(item.name)
        if known is None or same is None or item.parent is None or same.parent != item.parent:
            continue
        if item.relation == "attached" or item.parent not in offset:
            continue
        on_fixed = true[item.parent].parent is None
        off = offset[item.name] - (0.0 if absolute and on_fixed else offset[item.parent])
        view = ends[item.name].pos[:2] / np.linalg.norm(ends[item.name].pos[:2])
        yield "along", abs(float(off @ view)) / known.along
        yield "across", abs(float(off @ [-view[1], view[0]])) / known.across
        turn = heading_deg(same, ends[item.name], begins[item.name])
        if turn is not None and known.yaw is not None:
            yield "yaw", math.radians(turn) / known.yaw
        yield "log_scale", abs(math.log(_diagonal(item) / _diagonal(same))) / known.log_scale


def _diagonal(item: SceneObject) -> float:
    return float(np.linalg.norm(np.subtract(*bounds(item.spec, item.joint_state))))

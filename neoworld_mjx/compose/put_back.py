"""Move objects back onto their supports if a fit moved them past the edge.

A fit moves an object along the line of sight. It may move the object past the edge of a table, so
that the object would fall to the floor, or forever if there is no floor. Objects that hang over the
edge of a movable object, such as a throw over a bed, do not change.
"""

import numpy as np
from numpy.typing import NDArray

from ..spec import SceneObject, SceneSpec, bounds
from ..spec.pose import IDENTITY, from_yaw, rotate

INSET = 0.5
"""Distance from the edge to which an object's middle is moved, relative to the object's least
width."""


def put_back(scene: SceneSpec) -> tuple[SceneSpec, dict[str, float]]:
    """Move each object whose middle is outside the box of its environment support back onto it.

    Args:
        scene: the composed scene.

    Returns:
        The scene, and the distance [m] by which each object moved, by name.
    """
    objects, moved = [], dict[str, float]()
    for item in scene.objects:
        shift = _shift(scene, item)
        if np.any(shift):
            xy = np.add(item.xy, shift)
            item = item.model_copy(update={"xy": tuple(xy.tolist())})
            moved[item.name] = float(np.linalg.norm(shift))
        objects.append(item)
    return scene.model_copy(update={"objects": tuple(objects)}), moved


def _shift(scene: SceneSpec, item: SceneObject) -> NDArray:
    """Return the shift in the support's frame [m], shape [2]; zero if the object needs no shift."""
    no_shift = np.zeros(2)
    if item.parent is None or item.static or item.relation != "on" or item.parent_link is not None:
        return no_shift
    parent = scene.object(item.parent)
    if not parent.environment or not np.allclose(parent.base_tilt, IDENTITY):
        return no_shift
    low, high = (ends[:2] for ends in bounds(parent.spec, parent.joint_state))
    lower, upper = bounds(item.spec, item.joint_state, item.base_tilt)
    offset = rotate(from_yaw(item.yaw), np.array([*(lower + upper)[:2] / 2, 0.0]))[:2]
    middle = np.add(item.xy, offset)
    if np.all((middle >= low) & (middle <= high)):
        return no_shift
    inset = np.minimum(INSET * float((upper - lower)[:2].min()), (high - low) / 2)
    return np.clip(middle, low + inset, high - inset) - middle

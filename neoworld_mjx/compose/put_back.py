"""Move objects that a fit leaves next to their support back onto it.

A fit moves an object along the line of sight, and may move it past the edge of a table, from which
it would fall to the floor or, without one, forever. What hangs over the edge of another object,
such as a throw over a bed, is left where it is.
"""

import numpy as np
from numpy.typing import NDArray

from ..spec import SceneObject, SceneSpec, bounds
from ..spec.pose import IDENTITY, from_yaw, rotate

INSET = 0.5
"""Distance from the edge to which an object's middle is moved, over its least width."""


def put_back(scene: SceneSpec) -> tuple[SceneSpec, dict[str, float]]:
    """Move each object whose middle is outside the box of its environment support onto it.

    Args:
        scene: the composed scene.

    Returns:
        The scene, and the distance [m] of each moved object, by name.
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
    """Return the shift [2] m in the support's frame; zero for an object that is on its support."""
    none = np.zeros(2)
    if item.parent is None or item.static or item.relation != "on" or item.parent_link is not None:
        return none
    parent = scene.object(item.parent)
    if not parent.environment or not np.allclose(parent.base_tilt, IDENTITY):
        return none
    low, high = (ends[:2] for ends in bounds(parent.spec, parent.joint_state))
    lower, upper = bounds(item.spec, item.joint_state, item.base_tilt)
    offset = rotate(from_yaw(item.yaw), np.array([*(lower + upper)[:2] / 2, 0.0]))[:2]
    middle = np.add(item.xy, offset)
    if np.all((middle >= low) & (middle <= high)):
        return none
    inset = np.minimum(INSET * float((upper - lower)[:2].min()), (high - low) / 2)
    return np.clip(middle, low + inset, high - inset) - middle

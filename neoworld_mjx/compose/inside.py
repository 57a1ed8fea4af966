"""Put what stands in a container onto its floor, where its parsed place is across the rim.

A rim is a centimetre wide and a parsed place a centimetre off: a pot in a pot, a block in a box.
Snapped there, it would stand on the rim, and the search would have to find the way down.
"""

import numpy as np
from jaxtyping import Float

from ..physics.layout import Layout, arrange
from ..physics.scene_arrays import snapped_heights
from ..spec import SceneObject, SceneSpec, bounds
from ..spec.extent import part_bounds

SHARES = (0.25, 0.5, 0.75, 1.0)
"""Shares of the way to the container's middle that are tried."""
LOWER, LOWER_M = 0.1, 0.005
"""Least gain of height, over the object's and [m]: a tilted floor is no reason to move."""
AS_LOW_M = 0.002
"""Height within which a place is as low as the lowest."""


def on_floor(parent: SceneObject, obj: SceneObject) -> SceneObject:
    """Return an object at the place nearest to its own at which it stands on the container's floor.

    Args:
        parent: the container.
        obj: an object that stands in it.

    Returns:
        The object where it is, unless towards the container's middle it stands lower.
    """
    root = {"parent": None, "parent_link": None, "environment": True, "xy": (0.0, 0.0)}
    base = parent.model_copy(update={**root, "z": 0.0, "yaw": 0.0})
    height = lambda item: _height(base, item)
    low, high = bounds(obj.spec, obj.joint_state, obj.base_tilt)
    way = _middle(parent, obj.parent_link) - np.array(obj.xy)
    first = height(obj)
    places = [
        obj.model_copy(update={"xy": tuple((np.array(obj.xy) + share * way).tolist())})
        for share in SHARES
    ]
    heights = [height(place) for place in places]
    lowest = min(heights)
    if first - lowest < max(LOWER * float(high[2] - low[2]), LOWER_M):
        return obj
    return next(p for p, h in zip(places, heights, strict=True) if h < lowest + AS_LOW_M)


def _middle(parent: SceneObject, link: str | None) -> Float[np.ndarray, " 2"]:
    if link is None:
        low, high = bounds(parent.spec, parent.joint_state)
    else:
        low, high = part_bounds(parent.spec, parent.spec.part(link))
    return ((low + high) / 2)[:2]


def _height(base: SceneObject, obj: SceneObject) -> float:
    scene = SceneSpec(name="inside", objects=(base, obj))
    return float(snapped_heights(arrange(scene), Layout.zero(1, 2))[1])

"""Put what is in a container where it goes in, though its parsed place is across a rim.

A rim is a centimetre wide and a parsed place some centimetres off: a pot in a pot, a tube in a
rack, a lid on its jar. Snapped there, it would stand on the rim, and the search would have to find
the way down.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from ..physics.layout import Layout, arrange
from ..physics.outline import extreme_points
from ..physics.scene_arrays import snapped_heights
from ..spec import SceneObject, SceneSpec, bounds
from ..spec.extent import part_bounds
from ..spec.pose import IDENTITY

SIDE = 48
"""Places along each side of the grid over a container: 2 mm apart over 10 cm."""
LOWER, LOWER_M = 0.1, 0.005
"""Least gain of height, over the object's and [m]: a tilted floor is no reason to move."""
DEEP = 0.5
"""Share of the largest gain that makes a place one of the container's inside."""
AS_LOW_M = 0.002
"""Height within which a place is as low as another."""
WITHIN = 0.9
"""Share of an object's half width by which its place is within the container's outline."""
CLEAR = 1
"""Distance from a wall, over the grid's spacing, up to which a place is moved away from it."""
ALIKE = 0.12
"""Difference of two footprints, over the larger one, up to which one covers the other."""


def entrance(
    parent: SceneObject, obj: SceneObject, others: Iterable[SceneObject] = ()
) -> Float[np.ndarray, " 2"] | None:
    """Return the place nearest to an object's own at which it stands inside its container.

    Args:
        parent: the container.
        obj: an object in it, or a lid on it; taken as upright.
        others: what is in the container already: no two stand in one place.

    Returns:
        The place [m], in the frame of `SceneObject.xy`; None if it stands nowhere lower.
    """
    root = {"parent": None, "parent_link": None, "environment": True, "xy": (0.0, 0.0)}
    base = parent.model_copy(update={**root, "z": 0.0, "yaw": 0.0})
    upright = obj.model_copy(update={"base_tilt": IDENTITY})
    scene = SceneSpec(name="inside", objects=(base, upright))
    low, high = _bounds_of(parent, obj.parent_link)
    step = (high - low)[:2] / (SIDE - 1)
    sides = np.linspace(low[:2], high[:2], SIDE).T
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    places = np.concatenate([(low + high)[None, :2] / 2, grid])
    own = np.array(obj.xy)
    first, *heights = _heights(scene, np.concatenate([own[None], places]))
    bottom, top = bounds(obj.spec, obj.joint_state)
    depths = _depths(parent, obj.parent_link, places)
    reach = min(float((top - bottom)[:2].min()) / 2, float(depths.max()))
    gains = np.where(depths > WITHIN * reach, first - np.array(heights), -np.inf)
    for other in others:
        gains[np.linalg.norm(places - other.xy, axis=1) < _room(obj, other)] = -np.inf
    if gains.max() < max(LOWER * float(top[2] - bottom[2]), LOWER_M):
        return None
    inside = gains > DEEP * gains.max()
    nearest = places[inside][np.linalg.norm(places[inside] - own, axis=1).argmin()]
    near = inside & (np.abs(places - nearest) <= (CLEAR + 0.5) * step).all(axis=1)
    near &= gains > gains[near].max() - AS_LOW_M
    centred = places[near].mean(axis=0)
    fits = first - _heights(scene, centred[None])[0] > gains[near].max() - AS_LOW_M
    return centred if fits else places[near][gains[near].argmax()]


def covers(parent: SceneObject, obj: SceneObject) -> bool:
    """Tell whether an object on another has its footprint, as a lid has its jar's."""
    ours = np.ptp(bounds(obj.spec, obj.joint_state), axis=0)[:2]
    low, high = _bounds_of(parent, obj.parent_link)
    theirs = (high - low)[:2]
    return bool(np.all(np.abs(np.sort(ours) - np.sort(theirs)) <= ALIKE * np.maximum(ours, theirs)))


def _room(a: SceneObject, b: SceneObject) -> float:
    """Return a distance [m] below which two objects are in the same place."""
    widths = [np.ptp(bounds(o.spec, o.joint_state), axis=0)[:2].min() for o in (a, b)]
    return float(sum(widths)) / 4


def _bounds_of(parent: SceneObject, link: str | None) -> Float[np.ndarray, "2 3"]:
    if link is None:
        return np.array(bounds(parent.spec, parent.joint_state))
    return np.array(part_bounds(parent.spec, parent.spec.part(link)))


def _depths(
    parent: SceneObject, link: str | None, places: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Return how far [m] places are within a container's outline."""
    if link is not None:
        low, high = _bounds_of(parent, link)
        return np.minimum(places - low[:2], high[:2] - places).min(axis=1)
    sides = ConvexHull(extreme_points(parent)[:, :2]).equations
    return -(places @ sides[:, :2].T + sides[:, 2]).max(axis=1)


def _heights(scene: SceneSpec, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Return the heights [m] at which the second object of a scene stands at places."""
    layout = Layout.zero(len(places), 2)
    xy = np.zeros((len(places), 2, 2), np.float32)
    xy[:, 1] = places - scene.objects[1].xy
    return snapped_heights(arrange(scene), Layout(xy, layout.yaw, layout.log_scale))[:, 1]

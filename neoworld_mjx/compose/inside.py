"""Placement of objects inside containers if their parsed positions overlap the rim.

Rims are about a centimeter wide, but parsed positions are off by some centimeters. If a nested pot,
a tube in a rack or a lid of a jar were snapped at its parsed position, it would stand on the rim.
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

GRID_SIZE = 48
"""Number of grid points along each side of a container, for example 2 mm apart over 10 cm."""
MIN_DROP, MIN_DROP_M = 0.1, 0.005
"""Smallest drop, relative to the object's height and [m]. A tilted floor causes smaller drops."""
INSIDE_FRACTION = 0.5
"""Fraction of the largest drop above which a grid point is inside the container."""
EQUAL_HEIGHT_M = 0.002
"""Difference up to which heights count as equal [m]."""
MIN_OUTLINE_DISTANCE = 0.9
"""Smallest distance of a position from the container's outline, relative to half of the object's
width."""
CENTERING_CELLS = 1
"""Neighborhood, in grid spacings, over which a position is centered between walls."""
FOOTPRINT_TOLERANCE = 0.12
"""Largest relative difference between two footprints at which one object covers the other."""


def position_inside(
    parent: SceneObject, obj: SceneObject, others: Iterable[SceneObject] = ()
) -> Float[np.ndarray, " 2"] | None:
    """Return the nearest position at which an object stands inside its container.

    Args:
        parent: the container.
        obj: an object in the container, or a lid on it; assumed to be upright.
        others: objects already in the container, which the result avoids.

    Returns:
        The position [m] in the frame of `SceneObject.xy`; None if the object is not lower at any
        other position.
    """
    root = {"parent": None, "parent_link": None, "environment": True, "xy": (0.0, 0.0)}
    base = parent.model_copy(update={**root, "z": 0.0, "yaw": 0.0})
    upright = obj.model_copy(update={"base_tilt": IDENTITY})
    scene = SceneSpec(name="inside", objects=(base, upright))
    low, high = _bounds_of(parent, obj.parent_link)
    step = (high - low)[:2] / (GRID_SIZE - 1)
    sides = np.linspace(low[:2], high[:2], GRID_SIZE).T
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    positions = np.concatenate([(low + high)[None, :2] / 2, grid])
    parsed_xy = np.array(obj.xy)
    parsed_height, *heights = _heights(scene, np.concatenate([parsed_xy[None], positions]))
    bottom, top = bounds(obj.spec, obj.joint_state)
    depths = _depths(parent, obj.parent_link, positions)
    reach = min(float((top - bottom)[:2].min()) / 2, float(depths.max()))
    gains = np.where(
        depths > MIN_OUTLINE_DISTANCE * reach, parsed_height - np.array(heights), -np.inf
    )
    for other in others:
        gains[np.linalg.norm(positions - other.xy, axis=1) < _min_separation(obj, other)] = -np.inf
    if gains.max() < max(MIN_DROP * float(top[2] - bottom[2]), MIN_DROP_M):
        return None
    inside = gains > INSIDE_FRACTION * gains.max()
    nearest = positions[inside][np.linalg.norm(positions[inside] - parsed_xy, axis=1).argmin()]
    nearby = inside & (np.abs(positions - nearest) <= (CENTERING_CELLS + 0.5) * step).all(axis=1)
    nearby &= gains > gains[nearby].max() - EQUAL_HEIGHT_M
    centred = positions[nearby].mean(axis=0)
    fits = parsed_height - _heights(scene, centred[None])[0] > gains[nearby].max() - EQUAL_HEIGHT_M
    return centred if fits else positions[nearby][gains[nearby].argmax()]


def has_same_footprint(parent: SceneObject, obj: SceneObject) -> bool:
    """Return whether an object and its parent have about equal footprints, like a lid and a jar."""
    size = np.ptp(bounds(obj.spec, obj.joint_state), axis=0)[:2]
    low, high = _bounds_of(parent, obj.parent_link)
    parent_size = (high - low)[:2]
    return bool(
        np.all(
            np.abs(np.sort(size) - np.sort(parent_size))
            <= FOOTPRINT_TOLERANCE * np.maximum(size, parent_size)
        )
    )


def _min_separation(a: SceneObject, b: SceneObject) -> float:
    """Return the distance [m] that the positions of two objects in a container must keep."""
    widths = [np.ptp(bounds(o.spec, o.joint_state), axis=0)[:2].min() for o in (a, b)]
    return float(sum(widths)) / 4


def _bounds_of(parent: SceneObject, link: str | None) -> Float[np.ndarray, "2 3"]:
    if link is None:
        return np.array(bounds(parent.spec, parent.joint_state))
    return np.array(part_bounds(parent.spec, parent.spec.part(link)))


def _depths(
    parent: SceneObject, link: str | None, positions: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Return the distances [m] of positions from a container's outline; positive inside it."""
    if link is not None:
        low, high = _bounds_of(parent, link)
        return np.minimum(positions - low[:2], high[:2] - positions).min(axis=1)
    sides = ConvexHull(extreme_points(parent)[:, :2]).equations
    return -(positions @ sides[:, :2].T + sides[:, 2]).max(axis=1)


def _heights(scene: SceneSpec, positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Return the heights [m] at which the second object of a scene stands at each position."""
    layout = Layout.zero(len(positions), 2)
    xy = np.zeros((len(positions), 2, 2), np.float32)
    xy[:, 1] = positions - scene.objects[1].xy
    return snapped_heights(arrange(scene), Layout(xy, layout.yaw, layout.log_scale))[:, 1]

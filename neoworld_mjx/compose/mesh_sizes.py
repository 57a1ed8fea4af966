"""Sizes of posed objects, corrected by the given heights.

If a method estimates a wrong size for an object, the object's middle may be right, but its
underside is wrong. A carton that is too small then floats above the table, and objects on the
carton float above it. Heights and sizes are corrected together, so that objects touch their
supports and their surfaces move as little as possible. The cost is the mean square displacement of
the points of each surface, summed over the objects. An equal vertical shift of all objects costs
nothing, because it means that the height of the support is wrong.
"""

from collections.abc import Collection

import numpy as np

from ..spec import SceneObject, SceneSpec, bounds, scale, world_poses
from ..spec.pose import Pose
from ..spec.scale import scaled_state

MAX_CHANGE = 0.2
"""Largest relative change of a size. If a larger change is needed, the height is probably wrong,
not the size."""


def fit_sizes(
    given: SceneSpec, supported: SceneSpec, fixed: Collection[str]
) -> tuple[SceneSpec, list[str]]:
    """Return the given scene, with objects scaled about their middles.

    Args:
        given: objects at their given poses, without parents.
        supported: the same objects on their supports, at the given sizes.
        fixed: names of the objects whose sizes do not change.

    Returns:
        The scene, and a note for each size that changed.
    """
    given_poses, supported_poses = world_poses(given), world_poses(supported)
    free = [item for item in supported.objects if not item.static]
    column = {item.name: k for k, item in enumerate(free)}
    # An object's rise is linear in the changes of its size and of the sizes of all objects below.
    rises: dict[str, np.ndarray] = {}
    displacement, extent = np.zeros(len(free)), np.zeros(len(free))
    for k, item in enumerate(free):
        height, rise = _middle(item, supported_poses[item.name])[2], np.zeros(len(free))
        underside = float(
            supported_poses[item.name].pos[2] + _lowest(item, supported_poses[item.name])
        )
        rise[k] = height - underside
        if item.parent in column:
            below = supported.object(item.parent)
            rise += rises[item.parent]
            rise[column[item.parent]] += underside - _middle(below, supported_poses[item.parent])[2]
        rises[item.name] = rise
        displacement[k] = height - _middle(given.object(item.name), given_poses[item.name])[2]
        extent[k] = _mean_square(item)
    changes = _least_motion(
        np.array(list(rises.values())),
        displacement,
        extent,
        np.array([i.name in fixed for i in free]),
    )
    sizes = {i.name: 1 + float(c) for i, c in zip(free, changes, strict=True) if abs(c) > 1e-3}
    objects = [
        _scaled(item, given_poses[item.name], sizes[item.name]) if item.name in sizes else item
        for item in given.objects
    ]
    notes = [
        f"{name} is scaled by {size:.2f} to fit the given heights" for name, size in sizes.items()
    ]
    return given.model_copy(update={"objects": tuple(objects)}), notes


def _least_motion(
    rises: np.ndarray, displacement: np.ndarray, extent: np.ndarray, fixed: np.ndarray
) -> np.ndarray:
    """Return the relative changes of size at which surfaces move least, shape [n].

    Args:
        rises: derivative of the rise of each middle with respect to each change of size [m], shape
            [n, n].
        displacement: rise of each middle at the given sizes [m], shape [n].
        extent: mean square distance of each surface from its middle [m^2], shape [n].
        fixed: True for each object whose size does not change, shape [n].
    """
    fixed, weights, n = fixed.copy(), np.ones(len(displacement)), len(displacement)
    while True:
        # Unknowns: the changes of size, and the shift of all objects.
        heights = np.column_stack([rises, -np.ones(n)]) * weights[:, None]
        spread = np.column_stack([np.diag(np.sqrt(extent)), np.zeros(n)])
        rows, right = (
            np.vstack([heights, spread]),
            np.concatenate([-displacement * weights, np.zeros(n)]),
        )
        rows[:, :n][:, fixed] = 0
        changes = np.linalg.lstsq(rows, right)[0][:n]
        largest = int(np.argmax(np.abs(changes)))
        if abs(changes[largest]) <= MAX_CHANGE:
            return changes
        fixed[largest], weights[largest] = True, 0.0


def _middle(item: SceneObject, pose: Pose) -> np.ndarray:
    """Return the middle of an object's bounding box in the world frame [m], shape [3]."""
    return pose.apply(np.mean(bounds(item.spec, item.joint_state), axis=0))


def _lowest(item: SceneObject, pose: Pose) -> float:
    """Return the height of an object's underside relative to its origin [m]."""
    return float(bounds(item.spec, item.joint_state, tuple(pose.quat.tolist()))[0][2])


def _mean_square(item: SceneObject) -> float:
    """Return the mean square distance of an object's surface from its middle [m^2]."""
    middle, total, area = np.mean(bounds(item.spec, item.joint_state), axis=0), 0.0, 0.0
    for part in item.spec.parts:
        for geom in part.geoms:
            vertices, faces = geom.shape.surface()
            corners = (geom.pose().apply(vertices) - middle)[faces]
            sides = corners[:, 1:] - corners[:, :1]
            areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
            squares = (corners**2).sum(axis=(1, 2)) + (corners.sum(axis=1) ** 2).sum(axis=1)
            total, area = total + float(areas @ squares) / 12, area + float(areas.sum())
    return total / area


def _scaled(item: SceneObject, pose: Pose, size: float) -> SceneObject:
    """Return an object without a parent, scaled about its middle."""
    state = scaled_state(item.spec, item.joint_state, size)
    shift = (1 - size) * (_middle(item, pose) - pose.pos)
    x, y, z = (pose.pos + shift).tolist()
    update = {"spec": scale(item.spec, size), "joint_state": state, "xy": (x, y), "z": z}
    return item.model_copy(update=update)

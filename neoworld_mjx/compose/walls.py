"""Displacement of objects out of the walls of their parents.

Parsed positions are off by about a centimeter, and containers are hardly wider than their contents.
An object may then stand at the right height with a corner in a wall. If it were snapped exactly, it
would be raised onto the rim and topple.
"""

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from ..physics.exact import geom_distance, pair_distance
from ..spec import SceneObject, SceneSpec, bounds
from ..spec.pose import IDENTITY
from .sliding import SceneColliders, compile_colliders, shift_object, supported_geoms

MIN_OVERLAP_M = 0.001
"""Smallest overlap that is cleared [m]; smaller overlaps pass the final check."""
CLEAR_M = 2e-4
"""Distance from the wall after an object has been moved [m]."""
MAX_SHIFT_RATIO = 0.5
"""Largest displacement, relative to the object's least width. If a larger one is needed, the object
does not fit."""
STEPS = 30
"""Maximum number of steps; each step moves out of the deepest overlap."""
MIN_HORIZONTAL = 0.7
"""Smallest horizontal component of the unit vector along an overlap; floors and slopes are not
walls."""


def clear_walls(scene: SceneSpec) -> tuple[SceneSpec, dict[str, float]]:
    """Move each object that overlaps a wall of its parent by the shortest distance that clears it.

    Args:
        scene: the composed and snapped scene.

    Returns:
        The scene, and the distance [m] by which each object moved, by name.

    Raises:
        SpecError: MuJoCo cannot compile the scene.
    """
    items = [o for o in scene.objects if _may_have_walls(scene, o)]
    if not items:
        return scene, {}
    collision_scene = compile_colliders(scene)
    moved: dict[str, float] = {}
    for item in items:
        shift = _clearing_shift(scene, item, collision_scene)
        if shift is not None:
            scene = shift_object(scene, item.name, shift)
            moved[item.name] = float(np.linalg.norm(shift))
    return scene, moved


def _may_have_walls(scene: SceneSpec, item: SceneObject) -> bool:
    """Return whether an object's parent extends above the object's bottom."""
    if item.parent is None or item.static or item.relation not in ("on", "in"):
        return False
    parent = scene.object(item.parent)
    if item.parent_link is not None or not np.allclose(parent.base_tilt, IDENTITY):
        return True
    bottom = item.z + bounds(item.spec, item.joint_state, item.base_tilt)[0][2]
    return bool(bounds(parent.spec, parent.joint_state)[1][2] > bottom + MIN_OVERLAP_M)


def _clearing_shift(
    scene: SceneSpec, item: SceneObject, collision_scene: SceneColliders
) -> Float[np.ndarray, " 2"] | None:
    """Return the horizontal displacement [m] out of the parent's walls, and move the geoms by it.

    Return None, and move nothing, if the object overlaps no wall, if it does not fit between the
    walls, or if it would overlap other objects more.
    """
    assert item.parent is not None
    model, data, owner = collision_scene
    geoms = np.flatnonzero(owner == scene.index(item.name))
    walls = np.flatnonzero(owner == scene.index(item.parent))
    moving = supported_geoms(scene, owner, item.name)
    others = np.flatnonzero((owner >= 0) & ~moving & (owner != scene.index(item.parent)))
    low, high = bounds(item.spec, item.joint_state, item.base_tilt)
    farthest = MAX_SHIFT_RATIO * float((high - low)[:2].min())
    initial_xpos, shift = data.geom_xpos.copy(), np.zeros(2)
    step = _step_out(model, data, geoms, walls, -MIN_OVERLAP_M)
    if step is None:
        return None
    gap = min(pair_distance(model, data, geoms, others), 0.0)
    for _ in range(STEPS):
        shift += step
        data.geom_xpos[moving, :2] += step
        step = _step_out(model, data, geoms, walls, CLEAR_M / 2)
        if step is None or np.linalg.norm(shift) > farthest:
            break
    fits = step is None and np.linalg.norm(shift) <= farthest
    if fits and pair_distance(model, data, geoms, others) >= gap:
        return shift
    data.geom_xpos[:] = initial_xpos
    return None


def _step_out(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray, walls: NDArray, limit: float
) -> Float[np.ndarray, " 2"] | None:
    """Return the horizontal displacement [m] out of the nearest wall, or None if none is near.

    A wall is near if its distance is less than `limit` [m].
    """
    nearest, shift, ends = limit, None, np.zeros(6)
    for a in geoms:
        gaps = np.linalg.norm(data.geom_xpos[walls] - data.geom_xpos[a], axis=1)
        gaps = gaps - model.geom_rbound[walls] - model.geom_rbound[a]
        # Skip planes, which have zero radius and are not walls.
        for b in walls[(gaps < max(nearest, 0.0)) & (model.geom_rbound[walls] > 0)]:
            gap = geom_distance(model, data, int(a), int(b), CLEAR_M, ends)
            if gap >= nearest:
                continue
            # The two end points are swapped for overlapping geoms.
            vector = (ends[3:] - ends[:3]) * (1.0 if gap > 0 else -1.0)
            horizontal = float(np.linalg.norm(vector[:2]))
            if horizontal > MIN_HORIZONTAL * np.linalg.norm(vector):
                nearest, shift = gap, (gap - CLEAR_M) * vector[:2] / horizontal
    return shift

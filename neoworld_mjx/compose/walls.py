"""Move what stands in or on its parent out of the walls that it overlaps sideways.

A parse is a centimetre off, and an inside is hardly wider than what is in it. Such a thing stands
at the right height with a corner in a wall; set down exactly, it would be raised onto the rim and
topple, and the search would move the container for it.
"""

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from ..physics.exact import geom_distance, pair_distance
from ..spec import SceneObject, SceneSpec, bounds
from ..spec.pose import IDENTITY
from .sliding import SceneColliders, colliders, riding, shifted

LEAST_M = 0.001
"""Overlap from which on an object is moved: less passes the final check."""
CLEAR_M = 2e-4
"""Distance from a wall to which it is moved."""
FARTHEST = 0.5
"""Longest way, over the object's least width: one that goes farther does not fit there."""
STEPS = 30
"""Most steps, each out of the wall that is overlapped deepest."""
LEVEL = 0.7
"""Least share of an overlap's direction that is level: a floor or a slope is no wall."""


def clear_walls(scene: SceneSpec) -> tuple[SceneSpec, dict[str, float]]:
    """Move each object that overlaps a wall of its parent as little as it takes to clear it.

    Args:
        scene: composed and snapped.

    Returns:
        The scene, and by the name of each object that moved how far [m].

    Raises:
        SpecError: MuJoCo cannot compile the scene.
    """
    standing = [o for o in scene.objects if _is_between(scene, o)]
    if not standing:
        return scene, {}
    solid = colliders(scene)
    moved: dict[str, float] = {}
    for item in standing:
        way = _way_out(scene, item, solid)
        if way is not None:
            scene = shifted(scene, item.name, way)
            moved[item.name] = float(np.linalg.norm(way))
    return scene, moved


def _is_between(scene: SceneSpec, item: SceneObject) -> bool:
    """Tell whether a parent of what stands in or on it is higher than where it stands."""
    if item.parent is None or item.static or item.relation not in ("on", "in"):
        return False
    parent = scene.object(item.parent)
    if item.parent_link is not None or not np.allclose(parent.base_tilt, IDENTITY):
        return True
    bottom = item.z + bounds(item.spec, item.joint_state, item.base_tilt)[0][2]
    return bool(bounds(parent.spec, parent.joint_state)[1][2] > bottom + LEAST_M)


def _way_out(
    scene: SceneSpec, item: SceneObject, solid: SceneColliders
) -> Float[np.ndarray, " 2"] | None:
    """Return the level way [m] out of the parent's walls; move the object's geoms along it.

    None, and nothing moved, where it overlaps none, does not fit between them, or would overlap
    something else more.
    """
    assert item.parent is not None
    model, data, owner = solid
    own = np.flatnonzero(owner == scene.index(item.name))
    walls = np.flatnonzero(owner == scene.index(item.parent))
    moving = riding(scene, owner, item.name)
    others = np.flatnonzero((owner >= 0) & ~moving & (owner != scene.index(item.parent)))
    low, high = bounds(item.spec, item.joint_state, item.base_tilt)
    farthest = FARTHEST * float((high - low)[:2].min())
    before, way = data.geom_xpos.copy(), np.zeros(2)
    out = _out_of_deepest(model, data, own, walls, -LEAST_M)
    if out is None:
        return None
    gap = min(pair_distance(model, data, own, others), 0.0)
    for _ in range(STEPS):
        way += out
        data.geom_xpos[moving, :2] += out
        out = _out_of_deepest(model, data, own, walls, CLEAR_M / 2)
        if out is None or np.linalg.norm(way) > farthest:
            break
    fits = out is None and np.linalg.norm(way) <= farthest
    if fits and pair_distance(model, data, own, others) >= gap:
        return way
    data.geom_xpos[:] = before
    return None


def _out_of_deepest(
    model: mujoco.MjModel, data: mujoco.MjData, own: NDArray, walls: NDArray, least: float
) -> Float[np.ndarray, " 2"] | None:
    """Return the level way [m] out of the wall that is nearest, if it is nearer than `least`."""
    nearest, out, ends = least, None, np.zeros(6)
    for a in own:
        gaps = np.linalg.norm(data.geom_xpos[walls] - data.geom_xpos[a], axis=1)
        gaps = gaps - model.geom_rbound[walls] - model.geom_rbound[a]
        # Planes have no radius, but are no walls.
        for b in walls[(gaps < max(nearest, 0.0)) & (model.geom_rbound[walls] > 0)]:
            gap = geom_distance(model, data, int(a), int(b), CLEAR_M, ends)
            if gap >= nearest:
                continue
            # Between solids that overlap, the ends have changed places.
            to = (ends[3:] - ends[:3]) * (1.0 if gap > 0 else -1.0)
            level = float(np.linalg.norm(to[:2]))
            if level > LEVEL * np.linalg.norm(to):
                nearest, out = gap, (gap - CLEAR_M) * to[:2] / level
    return out

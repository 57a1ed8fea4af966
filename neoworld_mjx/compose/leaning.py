"""Move what leans, at its parsed tilt, up to what it leans on, or out of it.

A parse judges a distance to some percent: a board leans a hand's breadth before its wall, onto
which it falls in every rollout, and ends at another tilt. Or it leans as far within the wall.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..physics.exact import geom_distance
from ..spec import SceneSpec, bounds, world_poses
from ..spec.pose import matrix
from .sliding import SceneColliders, colliders, riding, shifted

FARTHEST = 0.5
"""Longest way, over the object's height: beyond it leans on something else, or on nothing."""
LEAST_M = 0.001
"""Shorter ways are left to the search."""
TOUCHING_M = 2e-4
"""Distance at which two touch."""
STEPS = 60
"""Most steps, each by the distance to what is nearest ahead, or out of what is deepest."""
LEAST_LEAN, MOST_LEAN = np.radians(2.0), np.radians(60.0)
"""Tilts between which a thing leans: below it stands, above it lies."""
FOOT = 0.1
"""Share of the height up to which what touches an object carries it."""
AHEAD = 0.3
"""Least cosine between the way and the direction to what an object can lean on."""


def lean(scene: SceneSpec) -> tuple[SceneSpec, dict[str, tuple[float, str]]]:
    """Move each leaning object until it touches what is ahead of it, and overlaps nothing there.

    Those that are farthest along come first: a book leans on a book that leans on a wall.

    Args:
        scene: composed and snapped.

    Returns:
        The scene, and by the name of each object that moved how far [m], and to which other;
        negative is backwards, out of it.

    Raises:
        SpecError: MuJoCo cannot compile the scene.
    """
    ways = _ways(scene)
    if not ways:
        return scene, {}
    solid = colliders(scene)
    moved: dict[str, tuple[float, str]] = {}
    for name, way in ways:
        found = _gap(scene, name, way, solid)
        if found is not None:
            moved[name] = found
            scene = shifted(scene, name, found[0] * way)
    return scene, moved


def _ways(scene: SceneSpec) -> list[tuple[str, NDArray]]:
    """Return what leans and the level unit direction in which its top is, farthest along first."""
    ways = []
    for name, at in world_poses(scene).items():
        obj, up = scene.object(name), matrix(at.quat)[:, 2]
        tilt = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
        if obj.relation == "leaning" and not obj.static and LEAST_LEAN < tilt < MOST_LEAN:
            way = up[:2] / np.linalg.norm(up[:2])
            ways.append((float(way @ at.pos[:2]), name, way))
    return [(name, way) for _, name, way in sorted(ways, key=lambda entry: -entry[0])]


def _gap(
    scene: SceneSpec,
    name: str,
    way: NDArray,
    solid: SceneColliders,
) -> tuple[float, str] | None:
    """Return how far an object is from what is ahead of it [m], and what; move its geoms there.

    Negative is how far it has to go back out of it. None, and nothing moved, where it touches that
    already, nothing is near, or the way out is too long.
    """
    model, data, owner = solid
    moving = riding(scene, owner, name)
    own = np.flatnonzero(owner == scene.index(name))
    others = np.flatnonzero((owner >= 0) & ~moving)
    obj = scene.object(name)
    bottom, top = bounds(obj.spec, obj.joint_state, obj.base_tilt)
    height = float(top[2] - bottom[2])
    foot = data.body(name).xpos[2] + bottom[2] + FOOT * height
    before, gone, out_of = data.geom_xpos.copy(), 0.0, -1
    beyond = _beyond(data, own, others, owner, way)
    for _ in range(STEPS):
        back, other = _overlap_ahead(model, data, own, beyond, way)
        if other is None or back <= LEAST_M:
            break
        gone, out_of = gone - back, other
        data.geom_xpos[moving, :2] -= back * way
    if gone < -FARTHEST * height:
        data.geom_xpos[:] = before
        return None
    if gone:
        return gone, scene.objects[owner[out_of]].name
    for _ in range(STEPS):
        reach = FARTHEST * height - gone
        step, other = _nearest_ahead(model, data, own, others, way, reach, foot)
        if other is None:
            break
        if step <= TOUCHING_M:
            if gone < LEAST_M:
                break
            return gone, scene.objects[owner[other]].name
        # Where two just touch, MuJoCo finds no direction between them.
        step -= TOUCHING_M / 2
        gone += step
        data.geom_xpos[moving, :2] += step * way
    data.geom_xpos[:] = before
    return None


def _beyond(
    data: mujoco.MjData, own: NDArray, others: NDArray, owner: NDArray, way: NDArray
) -> NDArray:
    """Return the geoms of the objects whose middle is ahead of an object's: it leans on these.

    What stands before it and overlaps it is not to end up behind it.
    """
    along = data.geom_xpos[:, :2] @ way
    middles = {k: along[owner == k].mean() for k in np.unique(owner[others])}
    own_middle = along[own].mean()
    return others[[middles[k] > own_middle for k in owner[others]]]


def _overlap_ahead(
    model: mujoco.MjModel, data: mujoco.MjData, own: NDArray, others: NDArray, way: NDArray
) -> tuple[float, int | None]:
    """Return how far back [m] an object has to go out of the geom ahead that takes it farthest.

    None if it overlaps nothing ahead.
    """
    farthest, which, ends = 0.0, None, np.zeros(6)
    for a in own:
        gaps = np.linalg.norm(data.geom_xpos[others] - data.geom_xpos[a], axis=1)
        gaps = gaps - model.geom_rbound[others] - model.geom_rbound[a]
        for b in others[(gaps < 0) & (model.geom_rbound[others] > 0)]:
            depth = -geom_distance(model, data, int(a), int(b), TOUCHING_M, ends)
            to = ends[:3] - ends[3:]
            cosine = float(to[:2] @ way) / max(float(np.linalg.norm(to)), 1e-12)
            if depth > 0 and cosine > AHEAD and depth / cosine > farthest:
                farthest, which = depth / cosine, int(b)
    return farthest, which


def _nearest_ahead(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    own: NDArray,
    others: NDArray,
    way: NDArray,
    reach: float,
    foot: float,
) -> tuple[float, int | None]:
    """Return the distance [m] to the nearest geom ahead and above the foot, and which it is.

    None if there is none within reach.
    """
    nearest, which, ends = reach, None, np.zeros(6)
    for a in own:
        gaps = np.linalg.norm(data.geom_xpos[others] - data.geom_xpos[a], axis=1)
        gaps = gaps - model.geom_rbound[others] - model.geom_rbound[a]
        # Planes have no radius, but are the floor: nothing leans on it.
        for b in others[(gaps < nearest) & (model.geom_rbound[others] > 0)]:
            gap = geom_distance(model, data, int(a), int(b), nearest, ends)
            # Between solids that overlap, the ends have changed places.
            to = (ends[3:] - ends[:3]) * (1.0 if gap > 0 else -1.0)
            ahead = to[:2] @ way > AHEAD * np.linalg.norm(to) and ends[2] > foot
            if gap < nearest and ahead:
                nearest, which = max(gap, 0.0), int(b)
    return nearest, which

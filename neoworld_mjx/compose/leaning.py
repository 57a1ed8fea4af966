"""Move what leans, at its parsed tilt, up to what it leans on.

A parse judges a distance to some percent: a board leans a hand's breadth before its wall, onto
which it falls in every rollout, and ends at another tilt.
"""

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from ..physics.exact import object_of_geom, start_state
from ..spec import SceneObject, SceneSpec, bounds, support_frame, world_poses
from ..spec.pose import conjugate, matrix, rotate

FARTHEST = 0.5
"""Longest way, over the object's height: beyond it leans on something else, or on nothing."""
LEAST_M = 0.002
"""Shorter ways are left to the search."""
TOUCHING_M = 2e-4
STEPS = 60
LEAST_LEAN, MOST_LEAN = np.radians(2.0), np.radians(60.0)
"""Tilts between which a thing leans: below it stands, above it lies."""
FOOT = 0.1
"""Share of the height up to which what touches an object carries it."""
AHEAD = 0.3
"""Least cosine between the way and the direction to what an object can lean on."""


def lean(scene: SceneSpec) -> tuple[SceneSpec, dict[str, tuple[float, str]]]:
    """Move each leaning object that touches nothing ahead of it until it does.

    Those that are farthest along come first: a book leans on a book that leans on a wall.

    Args:
        scene: composed and snapped.

    Returns:
        The scene, and by the name of each object that moved how far [m], and to which other.

    Raises:
        SpecError: MuJoCo cannot compile the scene.
    """
    moved: dict[str, tuple[float, str]] = {}
    order = [(float(way @ at[:2]), name) for name, way, at in _ways(scene)]
    for _, name in sorted(order, reverse=True):
        found = _gap(scene, scene.object(name))
        if found is None:
            continue
        length, way, other = found
        moved[name] = length, other
        scene = _shifted(scene, name, length * way)
    return scene, moved


def _ways(scene: SceneSpec) -> list[tuple[str, NDArray, NDArray]]:
    """Return name, level unit direction in which the top is, and position of what leans."""
    ways = []
    for name, at in world_poses(scene).items():
        obj, up = scene.object(name), matrix(at.quat)[:, 2]
        lean = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
        if obj.relation == "leaning" and not obj.static and LEAST_LEAN < lean < MOST_LEAN:
            ways.append((name, up[:2] / np.linalg.norm(up[:2]), at.pos))
    return ways


def _gap(scene: SceneSpec, obj: SceneObject) -> tuple[float, Float[np.ndarray, " 2"], str] | None:
    """Return how far an object is from what is ahead of it [m], in which direction, and what."""
    way = next(way for name, way, _ in _ways(scene) if name == obj.name)
    model, data = start_state(scene)
    owner = object_of_geom(scene, model)
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    names = [item.name for item in scene.objects]
    with_it = {obj.name}
    for item in scene.objects:
        with_it |= {item.name} if item.parent in with_it else set()
    apart = {names.index(name) for name in with_it} | {-1}
    own = np.flatnonzero(solid & (owner == names.index(obj.name)))
    others = np.flatnonzero(solid & ~np.isin(owner, list(apart)))
    bottom, top = bounds(obj.spec, obj.joint_state, obj.base_tilt)
    height = float(top[2] - bottom[2])
    farthest, foot = FARTHEST * height, data.body(obj.name).xpos[2] + bottom[2] + FOOT * height
    gone = 0.0
    for _ in range(STEPS):
        step, other = _nearest_ahead(model, data, own, others, way, farthest - gone, foot)
        if other is None:
            return None
        if step <= TOUCHING_M:
            return None if gone < LEAST_M else (gone, way, names[owner[other]])
        # Where two just touch, MuJoCo finds no direction between them.
        step -= TOUCHING_M / 2
        gone += step
        data.geom_xpos[own, :2] += step * way
    return None


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
            gap = mujoco.mj_geomDistance(model, data, int(a), int(b), nearest, ends)
            # Between solids that overlap, the ends have changed places.
            to = (ends[3:] - ends[:3]) * (1.0 if gap > 0 else -1.0)
            ahead = to[:2] @ way > AHEAD * np.linalg.norm(to) and ends[2] > foot
            if gap < nearest and ahead:
                nearest, which = max(gap, 0.0), int(b)
    return nearest, which


def _shifted(scene: SceneSpec, name: str, shift: Float[np.ndarray, " 2"]) -> SceneSpec:
    obj = scene.object(name)
    local = np.array([*shift, 0.0])
    if obj.parent is not None:
        at = world_poses(scene)[obj.parent]
        frame = support_frame(scene.object(obj.parent), at, obj.parent_link)
        local = rotate(conjugate(frame.quat), local)
    place = tuple((np.array(obj.xy) + local[:2]).tolist())
    items = [o.model_copy(update={"xy": place}) if o is obj else o for o in scene.objects]
    return scene.model_copy(update={"objects": tuple(items)})

"""Placement of leaning objects in contact with the objects on which they lean.

Horizontal displacement of objects in a compiled scene, without compiling it again.

Parsed distances are accurate only to a few percent. A leaning board may therefore be some
centimeters in front of its wall, fall onto it in every rollout and settle at another tilt. It may
also overlap the wall.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from ..errors import SpecError
from ..physics.colliders import geom_distance, object_depths, object_of_geom, start_state
from ..spec import SceneSpec, bounds, support_frame, world_poses
from ..spec.pose import conjugate, matrix, rotate


class SceneColliders(NamedTuple):
    """A compiled scene in its initial state."""

    model: mujoco.MjModel
    data: mujoco.MjData
    owner: NDArray
    """Index of each geom's object; -1 for geoms that do not collide."""


def compile_colliders(scene: SceneSpec) -> SceneColliders:
    """Compile a scene in its initial state.

    Raises:
        SpecError: MuJoCo cannot compile the scene.
    """
    try:
        model, data = start_state(scene)
    except ValueError as error:
        raise SpecError(f"{scene.name}: {error}") from None
    owner = object_of_geom(scene, model)
    owner[(model.geom_contype == 0) & (model.geom_conaffinity == 0)] = -1
    return SceneColliders(model, data, owner)


def supported_geoms(scene: SceneSpec, owner: NDArray, name: str) -> NDArray:
    """Return a mask of the geoms of an object and of all objects that it supports."""
    names = {name}
    for item in scene.objects:
        names |= {item.name} if item.parent in names else set()
    return np.isin(owner, [scene.index(other) for other in names])


def shift_object(scene: SceneSpec, name: str, shift: Float[np.ndarray, " 2"]) -> SceneSpec:
    """Return a scene with an object moved by a horizontal shift [m] in the world frame."""
    obj = scene.object(name)
    local = np.array([*shift, 0.0])
    if obj.parent is not None:
        parent_pose = world_poses(scene)[obj.parent]
        frame = support_frame(scene.object(obj.parent), parent_pose, obj.parent_link)
        local = rotate(conjugate(frame.quat), local)
    xy = tuple((np.array(obj.xy) + local[:2]).tolist())
    items = [o.model_copy(update={"xy": xy}) if o is obj else o for o in scene.objects]
    return scene.model_copy(update={"objects": tuple(items)})


MAX_SHIFT_RATIO = 0.5
"""Largest displacement, relative to the object's height. An object does not lean on objects that
are farther away."""
MAX_SHIFT_RATIO_STATED = 1.0
"""Largest displacement of an object whose `leans_on` is stated, relative to its height."""
MIN_SHIFT_M = 0.001
"""Smallest displacement [m]; smaller ones are left to the search."""
TOUCHING_M = 2e-4
"""Distance up to which two objects count as touching [m]."""
STEPS = 60
"""Maximum number of steps; each step moves to the nearest geom ahead, or out of the deepest
overlap."""
MIN_LEAN, MAX_LEAN = np.radians(2.0), np.radians(60.0)
"""Range of tilts of a leaning object [rad]. At smaller tilts, the object stands; at larger ones, it
lies."""
FOOT_FRACTION = 0.1
"""Fraction of the object's height below which a contact is a support, not something to lean on."""
MIN_AHEAD_COSINE = 0.3
"""Smallest cosine between the direction of motion and the direction to an object to lean on."""


def lean(scene: SceneSpec) -> tuple[SceneSpec, dict[str, tuple[float, str]]]:
    """Move each leaning object until it touches the object ahead of it without overlap.

    The object ahead is the one that `leans_on` names, or else the nearest one.

    Objects that are farthest along their direction of lean are moved first, because a book may lean
    on a book that leans on a wall.

    Args:
        scene: the composed and snapped scene.

    Returns:
        The scene, and for each moved object the distance [m] and the name of the object that it
        leans on. The distance is negative if the object moved backward, out of an overlap.

    Raises:
        SpecError: MuJoCo cannot compile the scene.
    """
    directions = _lean_directions(scene)
    if not directions:
        return scene, {}
    collision_scene = compile_colliders(scene)
    moved: dict[str, tuple[float, str]] = {}
    for name, direction in directions:
        gap = _gap(scene, name, direction, collision_scene)
        if gap is not None:
            moved[name] = gap
            scene = shift_object(scene, name, gap[0] * direction)
    return scene, moved


def move_walls_into_contact(scene: SceneSpec) -> tuple[SceneSpec, dict[str, float]]:
    """Move walls into contact with the objects that lean on them.

    After an alignment with the photograph, the pose of a leaning object is known better than that
    of an even wall behind it, which shows no contours. A wall is an environment object that
    supports nothing. It moves by the smallest distance to an object that leans on it, unless this
    would increase its penetration of another object.

    Returns:
        The scene, and the distance [m] of each moved wall, by name.

    Raises:
        SpecError: MuJoCo cannot compile the scene.
    """
    directions, gaps_by_object = dict(_lean_directions(scene)), lean(scene)[1]
    supports = {item.parent for item in scene.objects}
    moved_walls = dict[str, float]()
    for wall in scene.objects:
        if not wall.environment or wall.name in supports:
            continue
        gaps = {
            name: gap for name, (gap, support) in gaps_by_object.items() if support == wall.name
        }
        if not gaps:
            continue
        nearest = min(gaps, key=lambda name: gaps[name])
        shift = -gaps[nearest] * directions[nearest]
        end = shift_object(scene, wall.name, shift)
        if _depth(end, wall.name) <= max(_depth(scene, wall.name), MIN_SHIFT_M):
            scene, moved_walls[wall.name] = end, float(np.linalg.norm(shift))
    return scene, moved_walls


def _depth(scene: SceneSpec, name: str) -> float:
    """Return the largest penetration depth [m] between an object and any other."""
    depths = object_depths(scene, *start_state(scene))
    return max((depth for pair, depth in depths.items() if name in pair), default=0.0)


def _lean_directions(scene: SceneSpec) -> list[tuple[str, NDArray]]:
    """Return the names of leaning objects and their horizontal directions of lean.

    Objects that are farthest along their directions come first.
    """
    directions = []
    for name, world_pose in world_poses(scene).items():
        obj, up = scene.object(name), matrix(world_pose.quat)[:, 2]
        tilt = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
        if obj.relation == "leaning" and not obj.static and MIN_LEAN < tilt < MAX_LEAN:
            direction = up[:2] / np.linalg.norm(up[:2])
            directions.append((float(direction @ world_pose.pos[:2]), name, direction))
    return [
        (name, direction) for _, name, direction in sorted(directions, key=lambda entry: -entry[0])
    ]


def _gap(
    scene: SceneSpec,
    name: str,
    direction: NDArray,
    collision_scene: SceneColliders,
) -> tuple[float, str] | None:
    """Return the distance [m] to the object ahead and its name; move the geoms by this distance.

    The distance is negative if the object has to move back, out of an overlap. Return None, and
    move nothing, if the objects already touch, if no object is near, or if the distance is too
    large.
    """
    model, data, owner = collision_scene
    moving = supported_geoms(scene, owner, name)
    geoms = np.flatnonzero(owner == scene.index(name))
    obj = scene.object(name)
    candidates = (owner >= 0) & ~moving
    farthest = MAX_SHIFT_RATIO
    if obj.leans_on in {item.name for item in scene.objects}:
        candidates &= owner == scene.index(obj.leans_on)
        farthest = MAX_SHIFT_RATIO_STATED
    others = np.flatnonzero(candidates)
    if not len(others):
        return None
    bottom, top = bounds(obj.spec, obj.joint_state, obj.base_tilt)
    height = float(top[2] - bottom[2])
    foot_height = data.body(name).xpos[2] + bottom[2] + FOOT_FRACTION * height
    initial_xpos, distance, overlapped = data.geom_xpos.copy(), 0.0, -1
    ahead = _geoms_ahead(data, geoms, others, owner, direction)
    for _ in range(STEPS):
        back, other = _overlap_ahead(model, data, geoms, ahead, direction)
        if other is None or back <= MIN_SHIFT_M:
            break
        distance, overlapped = distance - back, other
        data.geom_xpos[moving, :2] -= back * direction
    if distance < -farthest * height:
        data.geom_xpos[:] = initial_xpos
        return None
    if distance:
        return distance, scene.objects[owner[overlapped]].name
    for _ in range(STEPS):
        reach = farthest * height - distance
        step, other = _nearest_ahead(model, data, geoms, others, direction, reach, foot_height)
        if other is None:
            break
        if step <= TOUCHING_M:
            if distance < MIN_SHIFT_M:
                break
            return distance, scene.objects[owner[other]].name
        # MuJoCo gives no direction between geoms that just touch.
        step -= TOUCHING_M / 2
        distance += step
        data.geom_xpos[moving, :2] += step * direction
    data.geom_xpos[:] = initial_xpos
    return None


def _geoms_ahead(
    data: mujoco.MjData, geoms: NDArray, others: NDArray, owner: NDArray, direction: NDArray
) -> NDArray:
    """Return the geoms of the objects whose centers are ahead of an object's center.

    Objects that overlap and are in front therefore stay in front.
    """
    coordinates = data.geom_xpos[:, :2] @ direction
    centers = {k: coordinates[owner == k].mean() for k in np.unique(owner[others])}
    center = coordinates[geoms].mean()
    return others[[centers[k] > center for k in owner[others]]]


def _overlap_ahead(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray, others: NDArray, direction: NDArray
) -> tuple[float, int | None]:
    """Return the largest distance [m] back out of an overlapping geom ahead, and the geom.

    The geom is None if there is no overlap ahead.
    """
    farthest, geom, ends = 0.0, None, np.zeros(6)
    for a in geoms:
        gaps = np.linalg.norm(data.geom_xpos[others] - data.geom_xpos[a], axis=1)
        gaps = gaps - model.geom_rbound[others] - model.geom_rbound[a]
        for b in others[(gaps < 0) & (model.geom_rbound[others] > 0)]:
            depth = -geom_distance(model, data, int(a), int(b), TOUCHING_M, ends)
            vector = ends[:3] - ends[3:]
            cosine = float(vector[:2] @ direction) / max(float(np.linalg.norm(vector)), 1e-12)
            if depth > 0 and cosine > MIN_AHEAD_COSINE and depth / cosine > farthest:
                farthest, geom = depth / cosine, int(b)
    return farthest, geom


def _nearest_ahead(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    geoms: NDArray,
    others: NDArray,
    direction: NDArray,
    reach: float,
    foot_height: float,
) -> tuple[float, int | None]:
    """Return the distance [m] to the nearest geom ahead and above the foot, and the geom.

    The geom is None if no such geom is within `reach`.
    """
    nearest, geom, ends = reach, None, np.zeros(6)
    for a in geoms:
        gaps = np.linalg.norm(data.geom_xpos[others] - data.geom_xpos[a], axis=1)
        gaps = gaps - model.geom_rbound[others] - model.geom_rbound[a]
        # Skip planes, which have zero radius: objects do not lean on the floor.
        for b in others[(gaps < nearest) & (model.geom_rbound[others] > 0)]:
            gap = geom_distance(model, data, int(a), int(b), nearest, ends)
            # The two end points are swapped for overlapping geoms.
            vector = (ends[3:] - ends[:3]) * (1.0 if gap > 0 else -1.0)
            ahead = (
                vector[:2] @ direction > MIN_AHEAD_COSINE * np.linalg.norm(vector)
                and ends[2] > foot_height
            )
            if gap < nearest and ahead:
                nearest, geom = max(gap, 0.0), int(b)
    return nearest, geom

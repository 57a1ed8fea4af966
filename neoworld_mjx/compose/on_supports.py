"""Contact of objects with their supports: heights, and moves out of walls and onto supports.

Displacement of objects out of the walls of their parents.

Parsed positions are off by about a centimeter, and containers are hardly wider than their contents.
An object may then stand at the right height with a corner in a wall. If it were snapped exactly, it
would be raised onto the rim and topple.

Move objects back onto their supports if a fit moved them past the edge.

A fit moves an object along the line of sight. It may move the object past the edge of a table, so
that the object would fall to the floor, or forever if there is no floor. Objects that hang over the
edge of a movable object, such as a throw over a bed, do not change.
"""

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from ..config import ComposeOptions
from ..physics.colliders import geom_distance, pair_distance
from ..physics.layout import Layout, arrange
from ..physics.placed import VERTICAL
from ..physics.scene_arrays import snapped_heights
from ..spec import SceneObject, SceneSpec, bounds
from ..spec.pose import IDENTITY, from_yaw, rotate
from .leaning import (
    SceneColliders,
    compile_colliders,
    lean,
    move_walls_into_contact,
    shift_object,
    supported_geoms,
)
from .resting_pose import with_joint_friction

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


INSET = 0.5
"""Distance from the edge to which an object's middle is moved, relative to the object's least
width."""


def put_back(scene: SceneSpec) -> tuple[SceneSpec, dict[str, float]]:
    """Move each object whose middle is outside the box of its environment support back onto it.

    Args:
        scene: the composed scene.

    Returns:
        The scene, and the distance [m] by which each object moved, by name.
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
    """Return the shift in the support's frame [m], shape [2]; zero if the object needs no shift."""
    no_shift = np.zeros(2)
    if item.parent is None or item.static or item.relation != "on" or item.parent_link is not None:
        return no_shift
    parent = scene.object(item.parent)
    if not parent.environment or not np.allclose(parent.base_tilt, IDENTITY):
        return no_shift
    low, high = (ends[:2] for ends in bounds(parent.spec, parent.joint_state))
    lower, upper = bounds(item.spec, item.joint_state, item.base_tilt)
    offset = rotate(from_yaw(item.yaw), np.array([*(lower + upper)[:2] / 2, 0.0]))[:2]
    middle = np.add(item.xy, offset)
    if np.all((middle >= low) & (middle <= high)):
        return no_shift
    inset = np.minimum(INSET * float((upper - lower)[:2].min()), (high - low) / 2)
    return np.clip(middle, low + inset, high - inset) - middle


def in_contact(
    scene: SceneSpec, options: ComposeOptions | None = None, *, composed: SceneSpec | None = None
) -> tuple[SceneSpec, tuple[str, ...]]:
    """Put objects onto their supports, out of walls, and up to the objects on which they lean.

    Args:
        scene: the scene.
        options: options of the composition.
        composed: the scene before its alignment, see `restore_supported` and
            `move_walls_into_contact`; None if the scene was not aligned.

    Returns:
        The scene, and a note for each object that moved sideways and for each joint whose friction
        was raised.
    """
    options = options or ComposeOptions()
    notes: list[str] = []
    if options.hold_joints:
        scene = _with_joint_friction(scene, notes)
    refused_moves = dict[str, str]()
    if composed is not None:
        scene, refused_moves = restore_supported(scene, composed, options.gap_m)
    if not options.settle:
        return snap(scene, options.gap_m), tuple(notes)
    scene, returned = put_back(scene)
    scene = snap(scene, options.gap_m)
    notes += [
        f"{item}: composition kept it where it was before the alignment, which would have moved it "
        f"{refused}"
        for item, refused in refused_moves.items()
    ]
    notes += [
        f"{item}: composition moved it by {1e3 * distance:.0f} mm sideways, back onto "
        f"{scene.object(item).parent}"
        for item, distance in returned.items()
    ]
    scene, cleared = clear_walls(scene)
    scene = snap(scene, options.gap_m) if cleared else scene
    for item, distance in cleared.items():
        notes.append(
            f"{item}: composition moved it by {1e3 * distance:.0f} mm sideways, out of a wall "
            f"of {scene.object(item).parent}"
        )
    if composed is not None:
        scene, moved_walls = move_walls_into_contact(scene)
        for wall, distance in moved_walls.items():
            notes.append(
                f"{wall}: composition moved it by {1e3 * distance:.0f} mm, up to an object that "
                "leans on it"
            )
    scene, moved = lean(scene)
    scene = snap(scene, options.gap_m) if moved else scene
    for name, (distance, support) in moved.items():
        direction = "up to" if distance > 0 else "out of"
        notes.append(
            f"{name}: composition moved it by {1e3 * abs(distance):.0f} mm {direction} "
            f"{support}, on which it leans"
        )
    return scene, tuple(notes)


def _with_joint_friction(scene: SceneSpec, notes: list[str]) -> SceneSpec:
    """Raise the friction of joints on objects whose openings were aligned; see `joint_friction`."""
    objects = [
        with_joint_friction(item, notes)
        if item.uncertainty is not None and item.uncertainty.joints
        else item
        for item in scene.objects
    ]
    return scene.model_copy(update={"objects": tuple(objects)})


def restore_supported(
    scene: SceneSpec, composed: SceneSpec, gap: float
) -> tuple[SceneSpec, dict[str, str]]:
    """Move objects that the alignment moved off their supports back to their composed positions.

    The alignment uses contours and ignores the surface under an object. A shift of a millimeter can
    therefore put a tube onto the rim of its rack. A sideways move is refused in two cases:

    - The height of the object above its support changes by more than the bounds of
      `settling_displacement`.
    - The object moves past the edge of the object that carries it. For edges of environment
      supports, see `put_back`.

    Args:
        scene: the aligned scene.
        composed: the scene before the alignment, with the same objects.
        gap: clearance under snapped objects [m].

    Returns:
        The scene, and a phrase that describes each refused move, by the object's name.
    """
    objects, refused_moves = [], dict[str, str]()
    for item, level, composed_item in zip(
        scene.objects, snap(scene, gap).objects, composed.objects, strict=True
    ):
        rise = level.z - composed_item.z
        size = float(np.linalg.norm(np.subtract(*bounds(item.spec, item.joint_state))))
        if item.parent is None or item.static:
            objects.append(item)
            continue
        refused = ""
        if abs(rise) > VERTICAL[0] * size + VERTICAL[1]:
            direction = "up" if rise > 0 else "down"
            refused = f"{1e3 * abs(rise):.0f} mm {direction}, off what it rests on"
        elif _above(composed, composed_item) and not _above(scene, item):
            distance = float(np.linalg.norm(np.subtract(item.xy, composed_item.xy)))
            refused = f"by {1e3 * distance:.0f} mm, off {item.parent}"
        if refused:
            refused_moves[item.name] = refused
            # The support may have been scaled.
            ends = (bounds(s.object(item.parent).spec) for s in (scene, composed))
            size_now, size_composed = (float(np.linalg.norm(np.subtract(*end))) for end in ends)
            xy = np.array(composed_item.xy) * size_now / size_composed
            item = item.model_copy(update={"xy": tuple(xy.tolist()), "yaw": composed_item.yaw})
        objects.append(item)
    return scene.model_copy(update={"objects": tuple(objects)}), refused_moves


def _above(scene: SceneSpec, item: SceneObject) -> bool:
    """Return True if at least a part of an object's box is above the box of its parent object."""
    parent = scene.object(item.parent or "")
    if parent.environment or item.parent_link is not None:
        return True
    low, high = (ends[:2] for ends in bounds(parent.spec, parent.joint_state, parent.base_tilt))
    ends = np.array(bounds(item.spec, item.joint_state, item.base_tilt))
    corners = [(*(ends[i, 0], ends[j, 1]), 0.0) for i in (0, 1) for j in (0, 1)]
    footprint = np.add(item.xy, rotate(from_yaw(item.yaw), np.array(corners))[:, :2])
    return bool(np.all((footprint.max(axis=0) > low) & (footprint.min(axis=0) < high)))


def snap(scene: SceneSpec, gap: float = 1e-4) -> SceneSpec:
    """Place every object on the surface under its footprint, with a clearance of `gap` [m]."""
    arrangement = arrange(scene, gap=gap)
    z = snapped_heights(arrangement, Layout.zero(1, len(scene.objects)))[0]
    objects = [
        obj.model_copy(update={"z": float(h)}) if flag else obj
        for obj, h, flag in zip(scene.objects, z, arrangement.snapped, strict=True)
    ]
    return scene.model_copy(update={"objects": tuple(objects)})

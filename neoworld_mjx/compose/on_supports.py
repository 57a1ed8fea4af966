"""Contact of objects with their supports: heights from supports, and moves out of walls."""

import numpy as np

from ..config import ComposeOptions
from ..physics.layout import Layout, arrange
from ..physics.placed import VERTICAL
from ..physics.scene_arrays import snapped_heights
from ..spec import SceneObject, SceneSpec, bounds
from ..spec.pose import from_yaw, rotate
from .joint_friction import with_joint_friction
from .leaning import lean, move_walls_into_contact
from .put_back import put_back
from .walls import clear_walls


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

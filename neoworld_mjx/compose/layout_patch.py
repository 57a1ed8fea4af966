"""Manual edits of poses, boxes and joint states, applied to a composed scene.

The patch is stored in the run folder with the files of the steps. Composition applies it last, so
the edits persist when earlier steps run again.
"""

from collections.abc import Collection
from pathlib import Path

from pydantic import Field

from ..errors import SpecError
from ..io import read_model
from ..io.files import write_atomic
from ..spec import (
    Box2D,
    JointKey,
    Name,
    Number,
    SceneSpec,
    SceneTree,
    Spec,
    bounds,
    joint_keys,
    support_frame,
    world_poses,
)
from ..spec.pose import from_yaw, pose, yaw_of

LAYOUT_PATCH = "layout.patch.json"
"""Name of the patch's file in a run folder."""


class ObjectPlacement(Spec):
    """Manual edits of one object; if a field is None, the composed value is kept."""

    xy: tuple[Number, Number] | None = None
    """Position in the parent's frame [m]."""
    yaw: Number | None = None
    """Heading in the parent's frame [rad]."""
    box2d: Box2D | None = None
    """Box in the photograph [px]."""
    joint_state: dict[JointKey, Number] = Field(default_factory=dict)
    """Joint values [rad or m]; joints that are missing keep their values."""


class LayoutPatch(Spec):
    """Manual edits of a scene, by the object's name."""

    objects: dict[Name, ObjectPlacement] = Field(default_factory=dict)

    def merged(self, name: str, placement: ObjectPlacement) -> "LayoutPatch":
        """Return the patch updated with the fields that `placement` sets for an object."""
        before = self.objects.get(name, ObjectPlacement())
        update = {key: getattr(placement, key) for key in placement.model_fields_set}
        update["joint_state"] = before.joint_state | placement.joint_state
        return LayoutPatch(objects=self.objects | {name: before.model_copy(update=update)})

    def to_json(self) -> str:
        """Serialize the patch deterministically."""
        return self.model_dump_json(indent=1, exclude_none=True) + "\n"


def apply_layout(scene: SceneSpec, patch: LayoutPatch) -> tuple[SceneSpec, tuple[str, ...]]:
    """Apply a patch to a scene, and snap the objects onto their supports.

    Args:
        scene: the composed scene.
        patch: the edits.

    Returns:
        The scene, and the names of objects and joints in the patch that the scene does not contain.

    Raises:
        SpecError: the placed scene is invalid.
    """
    stale = [name for name in patch.objects if name not in {obj.name for obj in scene.objects}]
    objects = []
    for obj in scene.objects:
        placement = patch.objects.get(obj.name)
        if placement is None:
            objects.append(obj)
            continue
        known = {key for joint in obj.spec.joints for key in joint_keys(joint)}
        stale += [f"{obj.name}/{key}" for key in placement.joint_state if key not in known]
        state = {key: v for key, v in placement.joint_state.items() if key in known}
        objects.append(
            obj.model_copy(
                update={
                    "xy": placement.xy or obj.xy,
                    "box2d": placement.box2d or obj.box2d,
                    "yaw": obj.yaw if placement.yaw is None else placement.yaw,
                    "joint_state": obj.joint_state | state,
                }
            )
        )
    from .on_supports import snap

    return snap(scene.model_copy(update={"objects": tuple(objects)})), tuple(stale)


def kept_layout(scene: SceneSpec, tree: SceneTree, names: Collection[str]) -> LayoutPatch:
    """Return the patch that puts some objects of a composed scene where the tree has them.

    Args:
        scene: the composed scene.
        tree: the tree, in whose world frame the objects keep positions and headings.
        names: names of the objects.
    """
    poses, placements = world_poses(scene), {}
    for obj in (scene.object(name) for name in names if name in poses):
        assert obj.parent is not None
        low, high = bounds(obj.spec, obj.joint_state)
        box = tree.node(obj.name).box3d
        middle = pose((-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, 0.0))
        placed = pose(box.position, from_yaw(box.yaw)).then(middle)
        frame = support_frame(scene.object(obj.parent), poses[obj.parent], obj.parent_link)
        local = frame.inverse().then(placed)
        xy = (float(local.pos[0]), float(local.pos[1]))
        placements[obj.name] = ObjectPlacement(xy=xy, yaw=yaw_of(local.quat))
    return LayoutPatch(objects=placements)


def read_layout_patch(folder: Path) -> LayoutPatch:
    """Read the patch of a run folder; return an empty one if there is none.

    Raises:
        SpecError: the file cannot be read or is not a patch.
    """
    path = folder / LAYOUT_PATCH
    if not path.is_file():
        return LayoutPatch()
    return read_model(path, LayoutPatch, SpecError, "a layout patch")


def write_layout_patch(folder: Path, patch: LayoutPatch) -> None:
    """Write the patch of a run folder; if the patch is empty, delete the file.

    Raises:
        SpecError: the file cannot be written.
    """
    path = folder / LAYOUT_PATCH
    try:
        if patch.objects:
            write_atomic(path, patch.to_json())
        else:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise SpecError(f"cannot write {path}: {error.strerror}") from None

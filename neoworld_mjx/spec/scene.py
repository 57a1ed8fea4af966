"""The description of a scene of objects (Step 4), and the application of layouts.

A pose is (x, y, yaw) in the parent's frame plus a snapped height; children move with their parent.
The frame of a parent has its origin and yaw, but not its tilt; with `parent_link` it also follows
the link's displacement at the parent's joint state.
"""

import json
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from ..errors import SpecError
from ..io import read_model
from .base import JointKey, Name, Number, Quat, Spec, Vec3
from .camera import Camera
from .kinematics import joint_keys, link_poses
from .object import ObjectSpec
from .pose import IDENTITY, Pose, conjugate, from_yaw, pose, quat_mul, rotate, yaw_of
from .scale import scale, scaled_state
from .semantics import semantics_of
from .surface_pattern import Share
from .tree import Box2D, Relation

WORLD_POSES = "world_poses"
"""Entry of a written scene: origin [m] and rotation (w, x, y, z) of every object in the world."""
SEMANTICS = "semantics"
"""Entry of a written scene: label, category, parts and purposes of joints of every object."""


Deviation = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class PoseUncertainty(Spec):
    """Standard deviations of an object's place after its alignment with the photograph."""

    along: Deviation
    """Horizontal position along the camera's view [m]."""
    across: Deviation
    """Horizontal position across the camera's view [m]."""
    yaw: Deviation
    """Heading [rad]."""
    log_scale: Deviation
    """Logarithm of the size."""
    joints: dict[JointKey, Deviation] = Field(default={}, exclude_if=lambda value: not value)
    """Positions of joints that are seen open [rad or m]."""


class SceneObject(Spec):
    """An object with its place in the scene."""

    name: Name
    spec: ObjectSpec
    parent: Name | None = None
    parent_link: Name | None = None
    relation: Relation = "on"
    leans_on: Name | None = Field(default=None, exclude_if=lambda value: value is None)
    """Object against which it leans; None for the nearest one ahead."""
    environment: bool = False
    """True for a static support, which is not optimized."""
    fixed_base: bool = False
    xy: tuple[Number, Number] = (0.0, 0.0)
    """Position in the parent's frame [m]."""
    z: Number = 0.0
    """Height of the object's origin above the parent's [m], snapped."""
    yaw: Number = 0.0
    """Heading in the parent's frame [rad]."""
    base_tilt: Quat = IDENTITY
    joint_state: dict[JointKey, Number] = {}
    """Joint values [rad or m]; joints not named are at 0. A ball has name.x, name.y, name.z."""
    box2d: Box2D | None = None
    """Box in the photograph."""
    occluded: bool = False
    """True if `box2d` bounds only a part of the object."""
    depth: Number | None = None
    """Parsed distance of its centre along the view [m]."""
    parsed_size: Vec3 | None = None
    """Edge lengths of the parsed 3D box [m]."""
    scale_residual: Vec3 | None = None
    """Object size over parsed size per axis, minus 1, after isotropic rescaling."""
    uncertainty: PoseUncertainty | None = None
    """Uncertainty of the place that the photograph leaves; None if it was not aligned."""

    @property
    def static(self) -> bool:
        """True for environment supports and fastened objects, whose base cannot move."""
        return self.environment or self.fixed_base


class Backdrop(Spec):
    """An upright plane behind the scene, as its photograph shows it; it collides with nothing."""

    x: Number
    """Distance from the world's origin along +x, the horizontal direction of the camera [m]."""
    rgb: tuple[Share, Share, Share]
    """Display color (sRGB) in the photograph."""


class SceneSpec(Spec):
    """A composed scene."""

    name: Name = "scene"
    objects: tuple[SceneObject, ...] = Field(min_length=1)
    camera: Camera | None = None
    gravity: Vec3 = (0.0, 0.0, -9.81)
    backdrop: Backdrop | None = Field(default=None, exclude_if=lambda value: value is None)

    @model_validator(mode="before")
    @classmethod
    def _without_derived(cls, value: object) -> object:
        if isinstance(value, dict):
            return {k: v for k, v in value.items() if k not in (WORLD_POSES, SEMANTICS)}
        return value

    @model_validator(mode="after")
    def _hierarchy(self) -> "SceneSpec":
        earlier: dict[str, SceneObject] = {}
        for obj in self.objects:
            if obj.name in earlier:
                raise ValueError(f"object names must be unique, repeated: {obj.name}")
            if obj.parent is not None:
                if obj.parent not in earlier:
                    raise ValueError(f"object {obj.name}: parent {obj.parent!r} must come first")
                links = [part.name for part in earlier[obj.parent].spec.parts]
                if obj.parent_link is not None and obj.parent_link not in links:
                    raise ValueError(
                        f"object {obj.name}: parent_link {obj.parent_link!r} is not a part of "
                        f"{obj.parent}; parts are {', '.join(links)}"
                    )
                if obj.static and not earlier[obj.parent].static:
                    raise ValueError(
                        f"object {obj.name} is fixed to {obj.parent}, which is free to move; "
                        "make it one of that object's parts"
                    )
            joints = [key for joint in obj.spec.joints for key in joint_keys(joint)]
            for name in obj.joint_state:
                if name not in joints:
                    raise ValueError(
                        f"object {obj.name}: joint_state names {name!r}; joints are "
                        f"{', '.join(joints) or 'none'}"
                    )
            earlier[obj.name] = obj
        return self

    def object(self, name: str) -> SceneObject:
        """Return an object by name."""
        return next(obj for obj in self.objects if obj.name == name)

    def index(self, name: str) -> int:
        """Return the index of an object."""
        return [obj.name for obj in self.objects].index(name)

    def to_json(self) -> str:
        """Serialize deterministically, with world poses and semantics for other programs."""
        poses = {
            name: {"pos": world.pos.tolist(), "quat": world.quat.tolist()}
            for name, world in world_poses(self).items()
        }
        content = self.model_dump_json(indent=1).removesuffix("\n}")
        semantics = {item.name: semantics_of(item.spec) for item in self.objects}
        derived = json.dumps({WORLD_POSES: poses, SEMANTICS: semantics}, indent=1).removeprefix(
            "{\n"
        )
        return f"{content},\n{derived}\n"


def single_object_scene(item: SceneObject | ObjectSpec) -> SceneSpec:
    """Return a scene of one object, with its name; an ObjectSpec is placed at the origin."""
    placed = SceneObject(name=item.name, spec=item) if isinstance(item, ObjectSpec) else item
    return SceneSpec(name=item.name, objects=(placed,))


def read_scene(path: Path) -> SceneSpec:
    """Read the scene of a run folder, or a scene.json.

    Raises:
        SpecError: there is no such file, or it is not a scene.
    """
    path = Path(path)
    file = path / "scene.json" if path.is_dir() else path
    if not path.exists():
        raise SpecError(f"cannot read {path}: no such file or folder")
    if path.is_dir() and not file.exists():
        raise SpecError(f"{path} is no run folder with a scene: it holds no scene.json")
    if file.suffix != ".json":
        raise SpecError(f"{path}: expected a run folder or a scene.json")
    return read_model(file, SceneSpec, SpecError, "a scene")


def support_frame(parent: SceneObject, parent_pose: Pose, link: str | None) -> Pose:
    """Return the world frame of the children of a parent, or of one of its parts.

    `parent_pose` is the world pose of the parent's object frame, tilt included.
    """
    frame = pose(parent_pose.pos, from_yaw(yaw_of(parent_pose.quat)))
    if link is None:
        return frame
    moved = parent_pose.then(link_poses(parent.spec, parent.joint_state)[link])
    return pose(moved.pos, from_yaw(yaw_of(moved.quat)))


def world_poses(scene: SceneSpec) -> dict[str, Pose]:
    """Return every object's pose in the world: origin [m] and rotation, tilt included."""
    poses: dict[str, Pose] = {}
    for obj in scene.objects:
        frame = pose()
        if obj.parent is not None:
            frame = support_frame(scene.object(obj.parent), poses[obj.parent], obj.parent_link)
        pos = frame.pos + rotate(frame.quat, np.array([*obj.xy, obj.z]))
        yaw = quat_mul(frame.quat, from_yaw(obj.yaw))
        poses[obj.name] = pose(pos, quat_mul(yaw, obj.base_tilt))
    return poses


def moved_whole(scene: SceneSpec, by: Pose) -> SceneSpec:
    """Move a scene by a rigid transform of the world; its camera stays as it is.

    Args:
        scene: the scene.
        by: the transform [m]; one that is not about the vertical tilts what has no parent, and
            needs a scene without parents.

    Raises:
        SpecError: the transform tilts a scene with parents.
    """
    turn = yaw_of(by.quat)
    level = from_yaw(turn)
    tilts = abs(float(level @ by.quat)) < 1 - 1e-12
    if tilts and any(item.parent is not None for item in scene.objects):
        raise SpecError(f"scene {scene.name} has objects with parents, which cannot be tilted")
    objects = []
    for item in scene.objects:
        if item.parent is None:
            x, y, z = by.apply(np.array([*item.xy, item.z])).tolist()
            update: dict[str, object] = {"xy": (x, y), "z": z, "yaw": item.yaw + turn}
            if tilts:
                quat = quat_mul(by.quat, quat_mul(from_yaw(item.yaw), np.array(item.base_tilt)))
                yaw = yaw_of(quat)
                tilt = quat_mul(conjugate(from_yaw(yaw)), quat)
                update |= {"yaw": yaw, "base_tilt": tuple((tilt / np.linalg.norm(tilt)).tolist())}
            item = item.model_copy(update=update)
        objects.append(item)
    return scene.model_copy(update={"objects": tuple(objects)})


def rearranged(
    scene: SceneSpec,
    xy: Annotated[np.ndarray, "[object, 2]"],
    yaw: Annotated[np.ndarray, "[object]"],
    log_scale: Annotated[np.ndarray, "[object]"],
    z: Annotated[np.ndarray, "[object]"],
) -> SceneSpec:
    """Write a layout into a scene (scale, yaw, translation in that order).

    Args:
        scene: the composed scene.
        xy: offset of each object in its parent's frame, before the parent is scaled [m].
        yaw: offset of each object's yaw [rad].
        log_scale: log of each object's isotropic scale factor.
        z: snapped height of each object above its parent's origin [m].

    Returns:
        A scene whose zero layout is the given one. Offsets scale with the parent; sizes of children
        do not.
    """
    size = np.exp(np.asarray(log_scale, float))
    objects = []
    for i, obj in enumerate(scene.objects):
        parent = 1.0 if obj.parent is None else size[scene.index(obj.parent)]
        place = (np.array(obj.xy) + xy[i]) * parent
        update: dict[str, object] = {
            "xy": tuple(place.tolist()),
            "yaw": float(obj.yaw + yaw[i]),
            "z": float(z[i]),
        }
        if size[i] != 1.0:
            s = float(size[i])
            update["spec"] = scale(obj.spec, s)
            update["joint_state"] = scaled_state(obj.spec, obj.joint_state, s)
        objects.append(obj.model_copy(update=update))
    return scene.model_copy(update={"objects": tuple(objects)})

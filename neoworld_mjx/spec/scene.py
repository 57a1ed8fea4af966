"""The description of a scene of objects (Step 4), and the application of layouts.

A pose is (x, y, yaw) in the parent's frame plus a snapped height, so children move with their
parent. The parent's frame has the origin and the yaw of the parent, but not the tilt. With
`parent_link`, the frame also follows the displacement of this link at the parent's joint state.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ..errors import SpecError, choices
from ..io import read_model
from ..io.names import UNIQUE, repeated
from .base import JointKey, Meters, Name, NonNegative, Number, ObjectName, Quat, Spec, Vec3
from .camera import Camera
from .correlation import PoseCorrelation
from .kinematics import bounds, joint_keys, link_poses
from .object import ObjectSpec
from .pose import IDENTITY, Pose, conjugate, from_yaw, pose, quat_mul, rotate, yaw_of
from .room import Share
from .scale import scale, scaled_state
from .tree import Box2D, Cues, Relation

WORLD_POSES = "world_poses"
"""Key in a written scene: origin [m] and rotation (w, x, y, z) of each object in the world."""
_FORMER = "semantics"
"""Key in scenes of earlier versions, which is ignored."""


Deviation = NonNegative


class PoseUncertainty(Spec):
    """Standard deviations of an object's pose and size after alignment with the photograph."""

    along: Deviation
    """Standard deviation of the horizontal position along the camera's view [m]."""
    across: Deviation
    """Standard deviation of the horizontal position across the camera's view [m]."""
    yaw: Deviation | None
    """Standard deviation of the heading [rad]; None if the object looks the same at every heading,
    so that no photograph shows it."""
    log_scale: Deviation
    """Standard deviation of the logarithm of the size."""


class SceneObject(Spec):
    """An object, and its pose in the scene."""

    name: ObjectName
    spec: ObjectSpec
    parent: Name | None = None
    parent_link: Name | None = None
    relation: Relation = "on"
    leans_on: Name | None = Field(default=None, exclude_if=lambda value: value is None)
    """Object against which this object leans; if None, the nearest object in its direction."""
    environment: bool = False
    """True if the object is a static support of the environment, which is not optimized."""
    fixed_base: bool = False
    xy: tuple[Meters, Meters] = (0.0, 0.0)
    """Position in the parent's frame [m]."""
    z: Meters = 0.0
    """Height of the object's origin above the parent's [m], snapped."""
    yaw: Number = 0.0
    """Heading in the parent's frame [rad]."""
    base_tilt: Quat = IDENTITY
    joint_state: dict[JointKey, Number] = {}
    """Joint values [rad or m]; joints that are not listed are at 0. A ball joint has the keys
    NAME.x, NAME.y and NAME.z."""
    box2d: Box2D | None = None
    """Box in the photograph."""
    occluded: bool = False
    """True if `box2d` bounds only a part of the object."""
    depth: Meters | None = None
    """Parsed depth of the object's center along the view [m]."""
    parsed_size: tuple[Meters, Meters, Meters] | None = None
    """Edge lengths of the parsed 3D box [m]."""
    scale_residual: Vec3 | None = None
    """Object size divided by parsed size, minus 1, per axis, after isotropic rescaling."""
    cues: Cues = Field(default=Cues(), exclude_if=lambda value: value == Cues())
    """Stated deviations of the parsed values, and what else the parse states for the estimate."""
    uncertainty: PoseUncertainty | None = None
    """Uncertainty that remains after alignment with the photograph; None if not aligned."""
    known: Literal["size", "pose"] | None = Field(
        default=None, exclude_if=lambda value: value is None
    )
    """Known part of the object, which no stage changes: its size, or its size and its pose on its
    support."""

    held: bool = Field(default=False, exclude_if=lambda value: not value)
    """True if the object does not rest where the photograph shows it, and was fixed there, or
    supports such an object. A scene with held objects is not valid."""

    @property
    def static(self) -> bool:
        """True if the base of the object cannot move: an environment support, a fixed base, or
        held.
        """
        return self.environment or self.fixed_base or self.held


MAX_OBJECTS, MAX_GEOMS = 500, 10_000
"""Largest numbers of objects of a scene, and of their geoms."""


class Backdrop(Spec):
    """A vertical plane behind the scene, as in the photograph; it collides with nothing."""

    x: Meters
    """Distance of the plane from the world's origin along +x, which the camera faces [m]."""
    rgb: tuple[Share, Share, Share]
    """Display color (sRGB) in the photograph."""


class SceneSpec(Spec):
    """A composed scene."""

    name: Name = "scene"
    objects: tuple[SceneObject, ...] = Field(min_length=1, max_length=MAX_OBJECTS)
    camera: Camera | None = None
    gravity: Vec3 = (0.0, 0.0, -9.81)
    correlation: PoseCorrelation | None = Field(
        default=None, exclude_if=lambda value: value is None
    )
    """Correlations between the uncertainties of objects and camera; None if not aligned."""
    backdrop: Backdrop | None = Field(default=None, exclude_if=lambda value: value is None)

    @model_validator(mode="before")
    @classmethod
    def _without_derived(cls, value: object) -> object:
        if isinstance(value, dict):
            return {k: v for k, v in value.items() if k not in (WORLD_POSES, _FORMER)}
        return value

    @model_validator(mode="after")
    def _hierarchy(self) -> "SceneSpec":
        geoms = sum(len(part.geoms) for obj in self.objects for part in obj.spec.parts)
        if geoms > MAX_GEOMS:
            raise ValueError(f"the scene has {geoms} geoms; the limit is {MAX_GEOMS}")
        if twice := repeated(obj.name for obj in self.objects):
            raise ValueError(f"object {UNIQUE}: {', '.join(twice)}")
        earlier: dict[str, SceneObject] = {}
        for obj in self.objects:
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
        """Return an object by name.

        Raises:
            SpecError: there is no such object.
        """
        return self.objects[self.index(name)]

    def index(self, name: str) -> int:
        """Return the index of an object.

        Raises:
            SpecError: there is no such object.
        """
        names = [item.name for item in self.objects]
        if name not in names:
            raise SpecError(f"scene {self.name}: object: {choices(name, names)}")
        return names.index(name)

    def to_json(self) -> str:
        """Return the scene as JSON, with world poses for other programs.

        Equal scenes give equal strings.
        """
        poses = {
            name: {"pos": world.pos.tolist(), "quat": world.quat.tolist()}
            for name, world in world_poses(self).items()
        }
        content = self.model_dump_json(indent=1).removesuffix("\n}")
        derived = json.dumps({WORLD_POSES: poses}, indent=1).removeprefix("{\n")
        return f"{content},\n{derived}\n"


def single_object_scene(item: SceneObject | ObjectSpec) -> SceneSpec:
    """Return a scene of one object, with the object's name.

    An `ObjectSpec` is placed at the origin; a `SceneObject` keeps its pose.
    """
    scene_object = SceneObject(name=item.name, spec=item) if isinstance(item, ObjectSpec) else item
    return SceneSpec(name=item.name, objects=(scene_object,))


def read_scene(path: Path) -> SceneSpec:
    """Read the scene of a run folder, or a scene.json.

    Raises:
        SpecError: the file does not exist or does not contain a scene.
    """
    path = Path(path)
    file = path / "scene.json" if path.is_dir() else path
    if not path.exists():
        raise SpecError(f"cannot read {path}: no such file or folder")
    if (path / "run.json").is_file() and not file.exists():
        raise SpecError(
            f"{path} is a run folder without a scene: its run stopped before the step refine; "
            "continue it with neoworld reconstruct --resume, or name one of its objects, such as "
            "objects/NAME"
        )
    if path.is_dir() and not file.exists():
        raise SpecError(f"{path} is no run folder with a scene: it contains no scene.json")
    if file.suffix != ".json":
        raise SpecError(f"{path}: expected a run folder or a scene.json")
    return read_model(file, SceneSpec, SpecError, "a scene")


def support_frame(parent: SceneObject, parent_pose: Pose, link: str | None) -> Pose:
    """Return the frame of the children of a parent or, with `link`, of one of the parent's parts.

    Args:
        parent: the parent.
        parent_pose: pose of the parent's object frame in the world, including its tilt.
        link: name of the part that supports the children; if None, the whole parent.

    Returns:
        The frame in the world; its z axis is vertical.
    """
    frame = pose(parent_pose.pos, from_yaw(yaw_of(parent_pose.quat)))
    if link is None:
        return frame
    part_pose = parent_pose.then(link_poses(parent.spec, parent.joint_state)[link])
    return pose(part_pose.pos, from_yaw(yaw_of(part_pose.quat)))


def world_poses(scene: SceneSpec) -> dict[str, Pose]:
    """Return the pose of each object in the world frame, including its tilt, by name."""
    poses: dict[str, Pose] = {}
    for obj in scene.objects:
        frame = pose()
        if obj.parent is not None:
            frame = support_frame(scene.object(obj.parent), poses[obj.parent], obj.parent_link)
        pos = frame.pos + rotate(frame.quat, np.array([*obj.xy, obj.z]))
        yaw = quat_mul(frame.quat, from_yaw(obj.yaw))
        poses[obj.name] = pose(pos, quat_mul(yaw, obj.base_tilt))
    return poses


def world_bounds(item: SceneObject, at: Pose) -> tuple[NDArray, NDArray]:
    """Return the bounds (low [3], high [3]) [m] of an object's colliders at a pose in the world."""
    low, high = bounds(item.spec, item.joint_state, tuple(at.quat.tolist()))
    return at.pos + low, at.pos + high


def with_world_poses(scene: SceneSpec, ends: Mapping[str, Pose]) -> SceneSpec:
    """Return a scene with new world poses of some objects. All others move with their parents."""
    old_poses = world_poses(scene)
    new_poses = dict(old_poses)
    objects: list[SceneObject] = []
    for item in scene.objects:
        frame, before = pose(), pose()
        if item.parent is not None:
            parent = scene.object(item.parent)
            frame = support_frame(parent, new_poses[item.parent], item.parent_link)
            before = support_frame(parent, old_poses[item.parent], item.parent_link)
        end = ends.get(item.name, frame.then(before.inverse().then(old_poses[item.name])))
        new_poses[item.name] = end
        objects.append(
            _with_support_pose(item, frame.inverse().then(end)) if item.name in ends else item
        )
    return scene.model_copy(update={"objects": tuple(objects)})


def _with_support_pose(item: SceneObject, rest: Pose) -> SceneObject:
    """Return an object at a pose in its support frame, split into a tilt followed by a yaw."""
    turn = yaw_of(quat_mul(rest.quat, conjugate(quat_mul(from_yaw(item.yaw), item.base_tilt))))
    yaw = math.remainder(item.yaw + turn, 2 * math.pi)
    tilt = quat_mul(conjugate(from_yaw(yaw)), rest.quat)
    tilt = tilt / np.linalg.norm(tilt) * (1.0 if tilt[0] >= 0 else -1.0)
    return item.model_copy(
        update={
            "xy": tuple(rest.pos[:2].tolist()),
            "z": float(rest.pos[2]),
            "yaw": yaw,
            "base_tilt": tuple(tilt.tolist()),
        }
    )


def transformed_scene(scene: SceneSpec, transform: Pose) -> SceneSpec:
    """Move all objects of a scene by a rigid transform of the world frame; keep the camera.

    Args:
        scene: the scene.
        transform: the transform [m]. A transform that rotates about another axis than the vertical
            tilts the objects, and is possible only if no object has a parent.

    Raises:
        SpecError: the transform tilts a scene with parents.
    """
    turn = yaw_of(transform.quat)
    level = from_yaw(turn)
    tilts = abs(float(level @ transform.quat)) < 1 - 1e-12
    if tilts and any(item.parent is not None for item in scene.objects):
        raise SpecError(f"scene {scene.name} has objects with parents, which cannot be tilted")
    objects = []
    for item in scene.objects:
        if item.parent is None:
            x, y, z = transform.apply(np.array([*item.xy, item.z])).tolist()
            update: dict[str, object] = {"xy": (x, y), "z": z, "yaw": item.yaw + turn}
            if tilts:
                quat = quat_mul(
                    transform.quat, quat_mul(from_yaw(item.yaw), np.array(item.base_tilt))
                )
                yaw = yaw_of(quat)
                tilt = quat_mul(conjugate(from_yaw(yaw)), quat)
                update |= {"yaw": yaw, "base_tilt": tuple((tilt / np.linalg.norm(tilt)).tolist())}
            item = item.model_copy(update=update)
        objects.append(item)
    return scene.model_copy(update={"objects": tuple(objects)})


def scene_in_frame(scene: SceneSpec, frame: Pose) -> SceneSpec:
    """Return a scene in another frame whose z also points up, with its camera and no backdrop.

    Args:
        scene: the scene.
        frame: pose of the scene's world frame in the new frame [m].

    Raises:
        SpecError: z of the new frame does not point up.
    """
    turn = yaw_of(frame.quat)
    if abs(float(from_yaw(turn) @ frame.quat)) < 1 - 1e-12:
        raise SpecError(f"scene {scene.name} cannot be expressed in a tilted frame")
    camera = scene.camera
    if camera is not None:
        x, y, z = frame.apply(camera.position()).tolist()
        yaw = math.remainder(camera.yaw + turn, 2 * math.pi)
        camera = camera.model_copy(update={"xy": (x, y), "height": z, "yaw": yaw})
    moved = transformed_scene(scene, frame)
    # A backdrop is perpendicular to x of its world.
    return moved.model_copy(update={"camera": camera, "backdrop": None})


def with_layout(
    scene: SceneSpec,
    xy: Annotated[np.ndarray, "[object, 2]"],
    yaw: Annotated[np.ndarray, "[object]"],
    log_scale: Annotated[np.ndarray, "[object]"],
    z: Annotated[np.ndarray, "[object]"],
) -> SceneSpec:
    """Apply a layout to a scene: scale, then yaw, then translation.

    Args:
        scene: the composed scene.
        xy: offset of each object in its parent's frame, before the parent's scaling [m].
        yaw: offset of each object's yaw [rad].
        log_scale: logarithm of each object's isotropic scale factor.
        z: snapped height of each object above its parent's origin [m].

    Returns:
        The scene at the given layout. Positions of children scale with their parent; sizes of
        children do not.
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

"""Schema of the reasoner's answer: a scene in words and numbers that a model gives easily.

It is flatter than `SceneTree` and uses pixels of the shown picture, degrees, and tilts in words;
`to_tree` converts it into a `SceneTree` in pixels of the original, metres and radians. All errors
of an answer are reported at once, in words by which its author can correct it.

Names, docstrings and descriptions of the classes are part of the request: tapes hold answers to
these very ones.
"""

import math
import re
from typing import Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ..errors import SpecError
from ..spec import Box2D, Box3D, Camera, PartState, Quat, SceneTree, TreeNode
from ..spec.pose import IDENTITY, from_axis_angle, from_yaw, rotate
from ..spec.tree import Relation
from .photo import Photo

_NAME = re.compile(r"^[A-Za-z][A-Za-z0-9_]{0,47}$")
_TOWARDS = {
    "forward": (0.0, 1.0, 0.0),
    "backward": (0.0, -1.0, 0.0),
    "left": (-1.0, 0.0, 0.0),
    "right": (1.0, 0.0, 0.0),
}
"""Axis, in the object's frame, of the rotation that moves its top in that direction."""


class _Answer(BaseModel):
    model_config = ConfigDict(extra="forbid")


class CameraSeen(_Answer):
    """The camera that took the picture."""

    pitch_deg: float = Field(
        description="How far it looks down: 0 is level, 90 straight down [degrees]."
    )
    height: float = Field(description="Of the camera above z = 0 [m].")
    fovy_deg: float = Field(description="Vertical field of view of the whole picture [degrees].")
    roll_deg: float = Field(
        default=0.0,
        description="How far the camera is turned clockwise, so that the picture turns "
        "anticlockwise; 0 if verticals are upright [degrees].",
    )


class BoxSeen(_Answer):
    """Tight box around the visible pixels, in pixels of the picture shown."""

    left: float
    top: float
    right: float
    bottom: float


class PositionSeen(_Answer):
    """The middle of the object's footprint, at the height of its lowest point [m]."""

    x: float = Field(description="Ahead of the camera.")
    y: float = Field(description="To the left of the camera's axis; negative to the right.")
    z: float = Field(description="Of the object's lowest point.")


class SizeSeen(_Answer):
    """Outer size of the whole object, hidden parts included, open parts as they stand [m]."""

    length: float = Field(description="Along the object's own x axis: from its back to its front.")
    width: float = Field(description="Along its own y axis: from its right side to its left side.")
    height: float = Field(description="Along its own z axis.")


class TiltSeen(_Answer):
    """How the object is tipped from its usual upright pose."""

    towards: Literal["forward", "backward", "left", "right"] = Field(
        description="Where its top has gone, as the object itself faces."
    )
    degrees: float = Field(description="90 lies, 180 is upside down.")


class PartSeen(_Answer):
    """A part that can move, and how it stands in the picture."""

    part: str = Field(description="Name, such as drawer_top, door, lid.")
    motion: Literal["revolute", "continuous", "prismatic"] = Field(
        description="revolute: a hinge with limits; continuous: turns all the way round; "
        "prismatic: slides."
    )
    opening: float = Field(default=0.0, description="0 closed, 1 fully open.")


class ObjectSeen(_Answer):
    """One object, or one support of the environment."""

    name: str = Field(description="Unique; letters, digits and underscores, a letter first.")
    label: str = Field(description="What it is, in one to three words, such as coffee cup.")
    description: str = Field(
        description="Shape, parts, material and colours, for someone who has to build it."
    )
    environment: bool = Field(
        default=False,
        description="Whether it belongs to the room and never moves: floor, wall, table, counter, "
        "shelf.",
    )
    parent: str | None = Field(
        description="Name of what carries it; null for an environment support that stands on "
        "nothing listed."
    )
    relation: Relation = Field(
        default="on",
        description="on: rests on it; in: rests inside it; attached: fastened to it; leaning: "
        "stands on it and leans against something.",
    )
    parent_link: str | None = Field(
        default=None,
        description="The movable part of the parent that carries it, such as an open drawer.",
    )
    fixed_base: bool = Field(
        default=False, description="Whether it is fastened, built in or mounted."
    )
    occluded: bool = Field(
        default=False, description="Whether another object or the picture's edge hides a part."
    )
    occluded_by: list[str] = Field(
        default_factory=list, description="Names of the listed objects that hide a part of it."
    )
    box: BoxSeen
    position: PositionSeen
    size: SizeSeen
    yaw_deg: float = Field(
        default=0.0,
        description="Where its front points, seen from above, anticlockwise: 0 away from the "
        "camera, 90 to the left, 180 to the camera, -90 to the right [degrees].",
    )
    tilt: TiltSeen | None = Field(
        default=None, description="null if it stands upright or lies as it always does."
    )
    articulation: list[PartSeen] = Field(
        default_factory=list, description="Every part that can move, closed ones too."
    )


class SceneSeen(_Answer):
    """The scene in the photograph."""

    observations: str = Field(
        default="",
        description="First, in a few sentences: what carries what, what hides what, and the known "
        "sizes that camera and distances are estimated from.",
    )
    camera: CameraSeen
    objects: list[ObjectSeen]

    @model_validator(mode="after")
    def _consistent(self) -> "SceneSeen":
        problems = list(_problems(self))
        if problems:
            raise ValueError("; ".join(problems))
        try:
            # These checks do not depend on the size of the picture.
            _tree(self, (1.0, 1.0), (1, 1), clip=False)
        except ValidationError as error:
            raise ValueError(_phrase(error)) from None
        return self


def to_tree(answer: SceneSeen, photo: Photo) -> SceneTree:
    """Convert an answer into a scene tree in pixels of the upright original.

    Boxes are clipped at the picture's edges.

    Args:
        answer: the answer, its boxes in pixels of the picture shown.
        photo: the photograph that was shown.

    Raises:
        SpecError: a box lies outside the picture, or the tree is invalid; the message is written
            for the author of the answer.
    """
    shown, original = photo.size, photo.original_size
    outside = [
        f"object {item.name}: box {_corners(item.box)} lies outside the picture, which is "
        f"{shown[0]} x {shown[1]} pixels"
        for item in answer.objects
        if item.box.left >= shown[0]
        or item.box.top >= shown[1]
        or item.box.right <= 0
        or item.box.bottom <= 0
    ]
    if outside:
        raise SpecError("; ".join(outside))
    per_pixel = (original[0] / shown[0], original[1] / shown[1])
    try:
        return _tree(answer, per_pixel, original, clip=True)
    except ValidationError as error:
        raise SpecError(_phrase(error)) from None


def tilt_quat(tilt: TiltSeen | None) -> Quat:
    """Return the rotation before yaw of a tilt in words."""
    if tilt is None or tilt.degrees == 0:
        return IDENTITY
    turn = from_axis_angle(_TOWARDS[tilt.towards], math.radians(tilt.degrees))
    return tuple(turn.tolist())


def base_offset(size: Float[np.ndarray, "3"], yaw: float, tilt: Quat) -> Float[np.ndarray, "2"]:
    """Return the offset of a tilted box's bottom centre from its footprint's centre, x and y [m].

    A scene tree states the bottom centre, an answer the centre of the visible footprint.
    """
    turned = Box3D(position=(0, 0, 0), size=tuple(size.tolist()), yaw=0.0).corners(tilt)
    middle = (turned.min(axis=0) + turned.max(axis=0)) / 2
    return -rotate(from_yaw(yaw), [middle[0], middle[1], 0.0])[:2]


def _problems(answer: SceneSeen) -> list[str]:
    """List the errors that the tree's own validation would not report clearly."""
    problems = []
    if not answer.objects:
        problems.append("objects is empty: list at least what carries the rest")
    names = [item.name for item in answer.objects]
    for item in answer.objects:
        where = f"object {item.name}"
        if not _NAME.match(item.name):
            problems.append(f"{where}: a name has letters, digits and underscores, at most 48")
        if item.box.left >= item.box.right or item.box.top >= item.box.bottom:
            problems.append(
                f"{where}: box needs left < right and top < bottom, got {_corners(item.box)}"
            )
        for axis in ("length", "width", "height"):
            if not getattr(item.size, axis) > 0:
                problems.append(f"{where}: size.{axis} must be above 0")
        others = [("parent", item.parent), *(("occluded_by", other) for other in item.occluded_by)]
        for field, other in others:
            if other is not None and other not in names:
                problems.append(
                    f"{where}: {field} {other!r} is no object; they are {', '.join(names)}"
                )
        for part in item.articulation:
            if not _NAME.match(part.part):
                problems.append(
                    f"{where}: part {part.part!r} needs a name of letters, digits, underscores"
                )
        problems.extend(_link_problems(item, answer))
    camera = answer.camera
    if not 1 <= camera.fovy_deg <= 170:
        problems.append(f"camera: fovy_deg must lie in 1 .. 170, got {camera.fovy_deg:g}")
    if not -90 <= camera.pitch_deg <= 90:
        problems.append(f"camera: pitch_deg must lie in -90 .. 90, got {camera.pitch_deg:g}")
    return problems


def _link_problems(item: ObjectSeen, answer: SceneSeen) -> list[str]:
    parent = next((other for other in answer.objects if other.name == item.parent), None)
    if item.parent_link is None or parent is None:
        return []
    parts = [part.part for part in parent.articulation]
    if item.parent_link in parts:
        return []
    return [
        f"object {item.name}: parent_link {item.parent_link!r} is not in the articulation of "
        f"{parent.name}, which has {', '.join(parts) or 'no movable parts'}"
    ]


def _tree(
    answer: SceneSeen, per_pixel: tuple[float, float], size: tuple[int, int], *, clip: bool
) -> SceneTree:
    camera = Camera(
        width=size[0],
        height_px=size[1],
        fovy=math.radians(answer.camera.fovy_deg),
        height=answer.camera.height,
        pitch=math.radians(answer.camera.pitch_deg),
        roll=math.radians(answer.camera.roll_deg),
    )
    nodes = tuple(_node(item, per_pixel, size if clip else None) for item in answer.objects)
    return SceneTree(camera=camera, nodes=nodes)


def _node(
    item: ObjectSeen, per_pixel: tuple[float, float], size: tuple[int, int] | None
) -> TreeNode:
    x0, y0, x1, y1 = _corners(item.box)
    sx, sy = per_pixel
    pixels = [x0 * sx, y0 * sy, x1 * sx, y1 * sy]
    if size is not None:
        pixels = [float(np.clip(v, 0, size[i % 2])) for i, v in enumerate(pixels)]
    box2d = Box2D(x0=pixels[0], y0=pixels[1], x1=pixels[2], y1=pixels[3])
    yaw, tilt = math.radians(item.yaw_deg), tilt_quat(item.tilt)
    edges = np.array([item.size.length, item.size.width, item.size.height])
    place = np.array([item.position.x, item.position.y]) + base_offset(edges, yaw, tilt)
    return TreeNode(
        name=item.name,
        label=item.label,
        description=item.description,
        parent=item.parent,
        relation=item.relation,
        parent_link=item.parent_link,
        environment=item.environment,
        fixed_base=item.fixed_base,
        occluded=item.occluded or bool(item.occluded_by),
        occluded_by=tuple(dict.fromkeys(item.occluded_by)),
        box2d=box2d,
        box3d=Box3D(
            position=(float(place[0]), float(place[1]), item.position.z),
            size=tuple(edges.tolist()),
            yaw=math.remainder(yaw, 2 * math.pi),
        ),
        base_tilt=tilt,
        articulation=tuple(
            PartState(part=part.part, type=part.motion, opening=part.opening)
            for part in item.articulation
        ),
    )


def _corners(box: BoxSeen) -> tuple[float, float, float, float]:
    return box.left, box.top, box.right, box.bottom


def _phrase(error: ValidationError) -> str:
    lines = []
    for item in error.errors():
        where = ".".join(str(step) for step in item["loc"])
        message = item["msg"].removeprefix("Value error, ")
        lines.append(f"{where}: {message}" if where else message)
    return "; ".join(lines)

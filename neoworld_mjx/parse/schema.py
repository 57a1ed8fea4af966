"""Schema of the reasoner's response: a scene in words and numbers that a model gives easily.

It is flatter than `SceneTree` and uses pixels of the shown picture, degrees, and tilts in words;
`to_tree` converts it into a `SceneTree` in pixels of the original, metres and radians. All errors
of a response are reported at once, in words by which its author can correct it.

Names, docstrings and descriptions of the classes are part of the request: tapes hold responses to
these very ones.
"""

import math
from typing import Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, ValidationError, model_validator

from ..errors import SpecError
from ..io.names import MAX_NAME, NAME_RULE, is_name, plain_text
from ..spec import Box2D, Box3D, Camera, Cues, PartState, Quat, SceneTree, TreeNode
from ..spec.pose import IDENTITY, from_axis_angle, from_yaw, rotate
from ..spec.tree import Relation
from .photo import Photo
from .response_bounds import out_of_bounds, too_long
from .room_schema import (
    ParsedOutline,
    ParsedSurface,
    ResponsePart,
    phrase,
    support_outline,
    support_problems,
    support_surface,
)

MAX_LABEL, MAX_DESCRIPTION = 100, 4000
_EDGE_AXES: dict[str, Literal["x", "y", "z"]] = {"length": "x", "width": "y", "height": "z"}
"""Axis of the object's frame along each edge of `size`."""
_CameraNumber = Literal["pitch", "height", "fovy", "roll"]
_CAMERA_NAMES: dict[str, _CameraNumber] = {
    "pitch_deg": "pitch",
    "height": "height",
    "fovy_deg": "fovy",
    "roll_deg": "roll",
}
_TOWARDS = {
    "forward": (0.0, 1.0, 0.0),
    "backward": (0.0, -1.0, 0.0),
    "left": (-1.0, 0.0, 0.0),
    "right": (1.0, 0.0, 0.0),
}
"""Axis, in the object's frame, of the rotation that moves its top in that direction."""


class ParsedCamera(ResponsePart):
    """The camera that took the picture."""

    pitch_deg: float = Field(
        description="Angle below the horizontal: 0 is level, 90 straight down [degrees]."
    )
    height: float = Field(description="Height of the camera above z = 0 [m].")
    fovy_deg: float = Field(description="Vertical field of view of the whole picture [degrees].")
    roll_deg: float = Field(
        default=0.0,
        description="Clockwise roll of the camera, which turns the picture anticlockwise; 0 if "
        "verticals are upright [degrees].",
    )
    measured: list[Literal["pitch_deg", "height", "fovy_deg", "roll_deg"]] = Field(
        default_factory=list,
        description="The numbers above that you measured in the picture, from vanishing points, "
        "ellipses or several known sizes; the others count as guesses.",
    )


class ParsedBox(ResponsePart):
    """Tight box around the visible pixels, in pixels of the picture shown."""

    left: float
    top: float
    right: float
    bottom: float


class ParsedPosition(ResponsePart):
    """The middle of the object's footprint, at the height of its lowest point [m]."""

    x: float = Field(description="Distance ahead of the camera.")
    y: float = Field(
        description="Distance to the left of the camera's axis; negative to the right."
    )
    z: float = Field(description="Height of the object's lowest point.")


class ParsedSize(ResponsePart):
    """Outer size of the whole object, hidden parts included, moving parts as open as seen [m]."""

    length: float = Field(description="Along the object's own x axis: from its back to its front.")
    width: float = Field(description="Along its own y axis: from its right side to its left side.")
    height: float = Field(description="Along its own z axis.")


class ParsedTilt(ResponsePart):
    """Tilt of the object from its usual upright pose."""

    towards: Literal["forward", "backward", "left", "right"] = Field(
        description="Direction in which its top has moved, seen from the object itself."
    )
    degrees: float = Field(description="Angle of the tilt: 90 is lying, 180 upside down.")


class ParsedPixel(ResponsePart):
    """A pixel of the picture shown."""

    u: float = Field(description="Position to the right.")
    v: float = Field(description="Position downwards.")


class ParsedDoubt(ResponsePart):
    """Uncertainty of your numbers: two times in three the error is smaller than this."""

    position: float | None = Field(
        default=None, description="Error of `position` along the ground [m]."
    )
    size: float | None = Field(
        default=None, description="Error of `size`, as a fraction of it: 0.1 is ten per cent."
    )
    yaw_deg: float | None = Field(default=None, description="Error of `yaw_deg` [degrees].")


class ParsedPart(ResponsePart):
    """A part that can move, and how far it is open in the picture."""

    part: str = Field(description="Name, such as drawer_top, door, lid.")
    motion: Literal["revolute", "continuous", "prismatic"] = Field(
        description="revolute: a hinge with limits; continuous: turns all the way round; "
        "prismatic: slides."
    )
    opening: float = Field(default=0.0, description="0 closed, 1 fully open.")


class ParsedObject(ResponsePart):
    """One object, or one support of the environment."""

    name: str = Field(description="Unique; letters, digits and underscores, a letter first.")
    label: str = Field(description="Kind of object, in one to three words, such as coffee cup.")
    description: str = Field(
        description="Shape, parts, material and colours, for someone who has to build it."
    )
    environment: bool = Field(
        default=False,
        description="True if it belongs to the environment and never moves: floor, wall, table, "
        "counter, shelf.",
    )
    parent: str | None = Field(
        description="Name of the object that supports it; null for a support of the environment "
        "that stands on nothing listed."
    )
    relation: Relation = Field(
        default="on",
        description="on: rests on it; in: rests inside it; attached: fastened to it; leaning: "
        "stands on it and leans against something.",
    )
    parent_link: str | None = Field(
        default=None,
        description="The movable part of the parent that supports it, such as an open drawer.",
    )
    fixed_base: bool = Field(
        default=False, description="True if it is fastened, built in or mounted."
    )
    occluded: bool = Field(
        default=False,
        description="True if another object or the picture's edge hides a part of it.",
    )
    occluded_by: list[str] = Field(
        default_factory=list, description="Names of the listed objects that hide a part of it."
    )
    box: ParsedBox
    position: ParsedPosition
    size: ParsedSize
    yaw_deg: float = Field(
        default=0.0,
        description="Direction of its front, seen from above, anticlockwise: 0 away from the "
        "camera, 90 to the left, 180 towards the camera, -90 to the right [degrees].",
    )
    tilt: ParsedTilt | None = Field(
        default=None, description="null if it stands upright or lies as such objects usually do."
    )
    articulation: list[ParsedPart] = Field(
        default_factory=list, description="Every part that can move, including closed ones."
    )
    held_by: str | None = Field(
        default=None,
        description="Only for `attached`. null: it is fastened and stays (screwed, nailed, glued, "
        "hung up permanently). Otherwise what holds it although it can come off, such as the hook "
        "that its loop hangs over; it then stays only if its shape and its parent's shape hold it.",
    )
    contact: ParsedPixel | None = Field(
        default=None,
        description="The pixel at which it touches its support; of several, the one nearest to the "
        "camera, so the lowest in the picture. null if no point of contact is visible.",
    )
    cut_sides: list[Literal["left", "top", "right", "bottom"]] | None = Field(
        default=None,
        description="Sides of `box` at which the object continues, hidden by another object or cut "
        "off by the picture's edge. [] if all four show its own outline; null if unknown.",
    )
    known_size: list[Literal["length", "width", "height"]] = Field(
        default_factory=list,
        description="Edges of `size` that are standard for such objects (a soda can is 12.2 cm "
        "high, A4 paper 29.7 cm long) and not judged from this picture.",
    )
    doubt: ParsedDoubt | None = Field(
        default=None, description="Uncertainty of the numbers; null if you cannot estimate it."
    )
    outline: ParsedOutline | None = Field(
        default=None,
        description="Only for supports of the environment: shape seen from above; null if it is a "
        "rectangle.",
    )
    surface: ParsedSurface | None = Field(
        default=None, description="Only for supports of the environment: material, pattern, colour."
    )
    furniture: bool = Field(
        default=False,
        description="True for a support of the environment that is built from the picture.",
    )


class ParsedScene(ResponsePart):
    """The scene in the photograph."""

    observations: str = Field(
        default="",
        description="First, in a few sentences: what supports what, what hides what, and the known "
        "sizes from which camera and distances are estimated.",
    )
    camera: ParsedCamera
    objects: list[ParsedObject]

    @model_validator(mode="after")
    def _consistent(self) -> "ParsedScene":
        problems = list(_problems(self))
        if problems:
            raise ValueError("; ".join(problems))
        try:
            # These checks do not depend on the size of the picture.
            _tree(self, (1.0, 1.0), (1, 1), clip=False)
        except ValidationError as error:
            raise ValueError(phrase(error)) from None
        return self


def to_tree(response: ParsedScene, photo: Photo) -> SceneTree:
    """Convert a response into a scene tree in pixels of the upright original.

    Boxes are clipped at the picture's edges.

    Args:
        response: the response, its boxes in pixels of the picture shown.
        photo: the photograph that was shown.

    Raises:
        SpecError: a box lies outside the picture, or the tree is invalid; the message is written
            for the author of the response.
    """
    size, original = photo.size, photo.original_size
    outside = [
        f"object {obj.name}: box {_corners(obj.box)} lies outside the picture, which is "
        f"{size[0]} x {size[1]} pixels"
        for obj in response.objects
        if obj.box.left >= size[0]
        or obj.box.top >= size[1]
        or obj.box.right <= 0
        or obj.box.bottom <= 0
    ]
    if outside:
        raise SpecError("; ".join(outside))
    per_pixel = (original[0] / size[0], original[1] / size[1])
    try:
        return _tree(response, per_pixel, original, clip=True)
    except ValidationError as error:
        raise SpecError(phrase(error)) from None


def tilt_quat(tilt: ParsedTilt | None) -> Quat:
    """Return the rotation before yaw of a tilt in words."""
    if tilt is None or tilt.degrees == 0:
        return IDENTITY
    turn = from_axis_angle(_TOWARDS[tilt.towards], math.radians(tilt.degrees))
    return tuple(turn.tolist())


def base_offset(size: Float[np.ndarray, "3"], yaw: float, tilt: Quat) -> Float[np.ndarray, "2"]:
    """Return the offset of a tilted box's bottom centre from its footprint's centre, x and y [m].

    A scene tree states the bottom centre, a response the centre of the visible footprint.
    """
    turned = Box3D(position=(0, 0, 0), size=tuple(size.tolist()), yaw=0.0).corners(tilt)
    middle = (turned.min(axis=0) + turned.max(axis=0)) / 2
    return -rotate(from_yaw(yaw), [middle[0], middle[1], 0.0])[:2]


def _problems(response: ParsedScene) -> list[str]:
    """List the errors that the tree's own validation would not report clearly."""
    problems = list(too_long(response))
    if problems:
        return problems[:1]  # The others would be errors about each of the things.
    if not response.objects:
        problems.append("objects is empty: list at least the support of the rest")
    names = [obj.name for obj in response.objects]
    problems.extend(_same_names(names))
    problems.extend(out_of_bounds(response))
    for obj in response.objects:
        where = f"object {plain_text(obj.name, MAX_NAME)}"
        if not is_name(obj.name):
            problems.append(f"{where}: a name has {NAME_RULE}")
        if obj.box.left >= obj.box.right or obj.box.top >= obj.box.bottom:
            problems.append(
                f"{where}: box needs left < right and top < bottom, got {_corners(obj.box)}"
            )
        others = [("parent", obj.parent), *(("occluded_by", other) for other in obj.occluded_by)]
        for field, other in others:
            if other is not None and other not in names:
                problems.append(
                    f"{where}: {field} {plain_text(other, MAX_NAME)!r} is no object; they are "
                    f"{plain_text(', '.join(names), 2000)}"
                )
        for part in obj.articulation:
            if not is_name(part.part):
                problems.append(
                    f"{where}: part {plain_text(part.part, MAX_NAME)!r} needs a name of {NAME_RULE}"
                )
        declared = (obj.environment, obj.furniture, obj.outline, obj.surface)
        problems.extend(f"{where}: {problem}" for problem in support_problems(*declared))
        problems.extend(_link_problems(obj, response))
    return problems


def _same_names(names: list[str]) -> list[str]:
    """Return an error for each name that another one differs from by case alone."""
    spelled: dict[str, str] = {}
    return [
        f"object {plain_text(name, MAX_NAME)}: {spelled[name.lower()]} differs by case alone"
        for name in names
        if spelled.setdefault(name.lower(), name) != name
    ]


def _link_problems(obj: ParsedObject, response: ParsedScene) -> list[str]:
    parent = next((other for other in response.objects if other.name == obj.parent), None)
    if obj.parent_link is None or parent is None:
        return []
    parts = [part.part for part in parent.articulation]
    if obj.parent_link in parts:
        return []
    return [
        f"object {obj.name}: parent_link {obj.parent_link!r} is not in the articulation of "
        f"{parent.name}, which has {', '.join(parts) or 'no movable parts'}"
    ]


def _tree(
    response: ParsedScene, per_pixel: tuple[float, float], size: tuple[int, int], *, clip: bool
) -> SceneTree:
    camera = Camera(
        width=size[0],
        height_px=size[1],
        fovy=math.radians(response.camera.fovy_deg),
        height=response.camera.height,
        pitch=math.radians(response.camera.pitch_deg),
        roll=math.radians(response.camera.roll_deg),
    )
    nodes = tuple(_node(obj, per_pixel, size if clip else None) for obj in response.objects)
    names = dict.fromkeys(response.camera.measured)
    measured: list[_CameraNumber] = [_CAMERA_NAMES[name] for name in names]
    return SceneTree(camera=camera, camera_measured=tuple(measured), nodes=nodes)


def _node(
    obj: ParsedObject, per_pixel: tuple[float, float], size: tuple[int, int] | None
) -> TreeNode:
    x0, y0, x1, y1 = _corners(obj.box)
    sx, sy = per_pixel
    pixels = [x0 * sx, y0 * sy, x1 * sx, y1 * sy]
    if size is not None:
        pixels = [float(np.clip(v, 0, size[i % 2])) for i, v in enumerate(pixels)]
    box2d = Box2D(x0=pixels[0], y0=pixels[1], x1=pixels[2], y1=pixels[3])
    yaw, tilt = math.radians(obj.yaw_deg), tilt_quat(obj.tilt)
    edges = np.array([obj.size.length, obj.size.width, obj.size.height])
    place = np.array([obj.position.x, obj.position.y]) + base_offset(edges, yaw, tilt)
    return TreeNode(
        name=obj.name,
        label=plain_text(obj.label, MAX_LABEL),
        description=plain_text(obj.description, MAX_DESCRIPTION),
        parent=obj.parent,
        relation=obj.relation,
        parent_link=obj.parent_link,
        environment=obj.environment,
        fixed_base=obj.fixed_base,
        occluded=obj.occluded or bool(obj.occluded_by),
        occluded_by=tuple(dict.fromkeys(obj.occluded_by)),
        box2d=box2d,
        box3d=Box3D(
            position=(float(place[0]), float(place[1]), obj.position.z),
            size=tuple(edges.tolist()),
            yaw=math.remainder(yaw, 2 * math.pi),
        ),
        base_tilt=tilt,
        articulation=tuple(
            PartState(part=part.part, type=part.motion, opening=part.opening)
            for part in obj.articulation
        ),
        held_by=plain_text(obj.held_by or "", MAX_LABEL) or None,
        cues=_cues(obj, per_pixel),
        outline=support_outline(obj.outline),
        surface=support_surface(obj.surface),
        furniture=obj.furniture,
    )


def _cues(obj: ParsedObject, per_pixel: tuple[float, float]) -> Cues:
    doubt = obj.doubt or ParsedDoubt()
    contact = None
    if obj.contact is not None:
        contact = (obj.contact.u * per_pixel[0], obj.contact.v * per_pixel[1])
    return Cues(
        contact=contact,
        cut_sides=None if obj.cut_sides is None else tuple(dict.fromkeys(obj.cut_sides)),
        known_size=tuple(_EDGE_AXES[edge] for edge in dict.fromkeys(obj.known_size)),
        position_sd=doubt.position,
        size_sd=doubt.size,
        yaw_sd=None if doubt.yaw_deg is None else math.radians(doubt.yaw_deg),
    )


def _corners(box: ParsedBox) -> tuple[float, float, float, float]:
    return box.left, box.top, box.right, box.bottom

"""Schema of the reasoner's response, and its conversion into a `SceneTree`.

The response is less nested than a scene tree. It uses pixels of the resized picture, degrees, and
words for the directions of tilts. Validation reports all errors of a response at once, in words for
the model. Names, docstrings and descriptions of the classes are part of the request, as in
`object_schema`.

Conversion of a response to a scene tree in pixels of the original, meters and radians.

The positions in a response are consistent with the picture only through its camera. If a correction
changes the camera, `moved_with_camera` moves each object to the position that has the same pixel.
"""

import math
from collections.abc import Collection, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, Field, ValidationError, model_validator

from ..errors import SpecError
from ..io.names import MAX_NAME, plain_text
from ..spec import Box2D, Box3D, Camera, Cues, PartState, Quat, SceneTree, TreeNode
from ..spec.pose import IDENTITY, from_axis_angle, from_yaw, rotate
from ..spec.room import RECTANGLE
from .object_schema import (
    ParsedBox,
    ParsedCamera,
    ParsedDoubt,
    ParsedObject,
    ParsedTilt,
    ResponsePart,
    error_line,
)
from .photo import Photo

MAX_LABEL, MAX_DESCRIPTION = 100, 4000
_EDGE_AXES: dict[str, Literal["x", "y", "z"]] = {"length": "x", "width": "y", "height": "z"}
"""Axis of the object's frame that is parallel to each edge of `size`."""
_CameraNumber = Literal["pitch", "height", "fovy", "roll"]
_CAMERA_NAMES: dict[str, _CameraNumber] = {
    "pitch_deg": "pitch",
    "height": "height",
    "fovy_deg": "fovy",
    "roll_deg": "roll",
}
FARTHEST = 3.0
"""Maximum factor by which the distance of an object from the camera may grow or shrink if its
camera is corrected."""
_TOWARDS = {
    "forward": (0.0, 1.0, 0.0),
    "backward": (0.0, -1.0, 0.0),
    "left": (-1.0, 0.0, 0.0),
    "right": (1.0, 0.0, 0.0),
}
"""Rotation axis, in the object's frame, by which the object's top moves in each direction."""


def camera_of(parsed: ParsedCamera, size: tuple[int, int]) -> Camera:
    """Return the parsed camera for a picture with this width and height [px].

    Raises:
        ValidationError: the camera is invalid.
    """
    return Camera(
        width=size[0],
        height_px=size[1],
        fovy=math.radians(parsed.fovy_deg),
        height=parsed.height,
        pitch=math.radians(parsed.pitch_deg),
        roll=math.radians(parsed.roll_deg),
    )


def build_tree(
    camera: ParsedCamera,
    objects: Sequence[ParsedObject],
    per_pixel: tuple[float, float],
    size: tuple[int, int],
    *,
    clip: bool,
) -> SceneTree:
    """Convert parsed objects into a scene tree.

    Args:
        camera: the parsed camera.
        objects: the parsed objects.
        per_pixel: original pixels per pixel of the resized picture, horizontally and vertically.
        size: width and height of the original [px].
        clip: if True, clip 2D boxes at the picture's edges.

    Raises:
        ValidationError: the tree is invalid.
    """
    nodes = tuple(_node(obj, per_pixel, size if clip else None) for obj in objects)
    names = dict.fromkeys(camera.measured)
    measured: list[_CameraNumber] = [_CAMERA_NAMES[name] for name in names]
    pitch_sd = camera.pitch_doubt_deg
    return SceneTree(
        camera=camera_of(camera, size),
        camera_measured=tuple(measured),
        pitch_sd=None if pitch_sd is None else math.radians(pitch_sd),
        height_sd=camera.height_doubt,
        nodes=nodes,
    )


def _node(
    obj: ParsedObject, per_pixel: tuple[float, float], size: tuple[int, int] | None
) -> TreeNode:
    x0, y0, x1, y1 = corners(obj.box)
    sx, sy = per_pixel
    pixels = [x0 * sx, y0 * sy, x1 * sx, y1 * sy]
    if size is not None:
        pixels = [float(np.clip(v, 0, size[i % 2])) for i, v in enumerate(pixels)]
    box2d = Box2D(x0=pixels[0], y0=pixels[1], x1=pixels[2], y1=pixels[3])
    yaw, tilt = math.radians(obj.yaw_deg), tilt_quat(obj.tilt)
    edges = np.array([obj.size.length, obj.size.width, obj.size.height])
    center = np.array([obj.position.x, obj.position.y]) + base_offset(edges, yaw, tilt)
    return TreeNode(
        name=obj.name,
        label=plain_text(obj.label, MAX_LABEL),
        description=plain_text(obj.description, MAX_DESCRIPTION),
        parent=obj.parent,
        relation=obj.relation,
        leans_on=obj.leans_on,
        parent_link=obj.parent_link,
        environment=obj.environment,
        fixed_base=obj.fixed_base,
        occluded=obj.occluded or bool(obj.occluded_by),
        occluded_by=tuple(dict.fromkeys(obj.occluded_by)),
        box2d=box2d,
        box3d=Box3D(
            position=(float(center[0]), float(center[1]), obj.position.z),
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
        outline=RECTANGLE if obj.outline is None else obj.outline.converted(),
        surface=None if obj.surface is None else obj.surface.converted(),
        furniture=obj.furniture,
    )


def _cues(obj: ParsedObject, per_pixel: tuple[float, float]) -> Cues:
    uncertainty = obj.doubt or ParsedDoubt()
    contact = None
    if obj.contact is not None:
        contact = (obj.contact.u * per_pixel[0], obj.contact.v * per_pixel[1])
    return Cues(
        contact=contact,
        cut_sides=None if obj.cut_sides is None else tuple(dict.fromkeys(obj.cut_sides)),
        known_size=tuple(_EDGE_AXES[edge] for edge in dict.fromkeys(obj.known_size)),
        position_sd=uncertainty.position,
        size_sd=uncertainty.size,
        yaw_sd=None if uncertainty.yaw_deg is None else math.radians(uncertainty.yaw_deg),
    )


def corners(box: ParsedBox) -> tuple[float, float, float, float]:
    """Return the left, top, right and bottom of a box."""
    return box.left, box.top, box.right, box.bottom


def tilt_quat(tilt: ParsedTilt | None) -> Quat:
    """Return the rotation of a parsed tilt, which is applied before the yaw."""
    if tilt is None or tilt.degrees == 0:
        return IDENTITY
    turn = from_axis_angle(_TOWARDS[tilt.towards], math.radians(tilt.degrees))
    return tuple(turn.tolist())


def base_offset(size: Float[np.ndarray, "3"], yaw: float, tilt: Quat) -> Float[np.ndarray, "2"]:
    """Return the offset (x, y) of a tilted box's bottom center from its footprint's center [m].

    A scene tree contains the bottom center, whereas a response contains the footprint's center.
    """
    corners = Box3D(position=(0, 0, 0), size=tuple(size.tolist()), yaw=0.0).corners(tilt)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return -rotate(from_yaw(yaw), [middle[0], middle[1], 0.0])[:2]


def moved_with_camera(
    objects: Sequence[ParsedObject],
    before: ParsedCamera,
    after: ParsedCamera,
    size: tuple[int, int],
    *,
    placed: Collection[str] = (),
) -> list[ParsedObject]:
    """Return the objects at positions with the same pixels and heights in the new camera.

    An object keeps its position if the position is outside the picture, or if the distance from the
    camera would change by more than a factor of three.

    Args:
        objects: the objects of the response.
        before: the old camera, for which the positions were given.
        after: the new camera.
        size: width and height of the picture that the model saw [px].
        placed: names of objects whose positions were given for the new camera.

    Raises:
        ValidationError: a camera is invalid.
    """
    old, new = (camera_of(parsed, size) for parsed in (before, after))
    return [obj if obj.name in placed else _moved_object(obj, old, new) for obj in objects]


def _moved_object(obj: ParsedObject, old: Camera, new: Camera) -> ParsedObject:
    at = obj.position
    pixel, depth = old.project([at.x, at.y, at.z])
    inside = (pixel >= 0).all() and (pixel <= [old.width, old.height_px]).all()
    if depth <= 0 or not inside:
        return obj
    ray = new.rays(pixel)
    distance = (at.z - new.height) / ray[2] if ray[2] else math.inf
    before = math.dist((at.x, at.y, at.z), (0.0, 0.0, old.height))
    if not before / FARTHEST < distance < before * FARTHEST:
        return obj
    new_position = {"x": float(distance * ray[0]), "y": float(distance * ray[1])}
    return obj.model_copy(update={"position": at.model_copy(update=new_position)})


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
        if problems := _problems(self):
            raise ValueError("; ".join(problems))
        try:
            # These checks do not depend on the size of the picture.
            build_tree(self.camera, self.objects, (1.0, 1.0), (1, 1), clip=False)
        except ValidationError as error:
            raise ValueError(error_line(error)) from None
        return self


class SceneCorrection(ResponsePart):
    """Changes of an earlier response."""

    observations: str = Field(
        default="", description="In a few sentences: what is corrected, and why; or what is not."
    )
    camera: ParsedCamera | None = Field(
        default=None, description="The complete camera if any of its numbers changes; else null."
    )
    objects: list[ParsedObject] = Field(
        default_factory=list,
        description="Only the objects that change or are new, each complete; an object replaces "
        "the earlier one of the same name.",
    )
    removed: list[str] = Field(
        default_factory=list, description="Names of the earlier objects that do not exist."
    )

    def applied(self, earlier: ParsedScene, size: tuple[int, int]) -> ParsedScene:
        """Return the corrected response; objects that are not listed again keep their pixels.

        Args:
            earlier: the response to correct.
            size: width and height of the picture that the model saw [px].

        Raises:
            ValidationError: the corrected scene is inconsistent; the messages are written for the
                model.
        """
        changed = {obj.name: obj for obj in self.objects}
        names = [obj.name for obj in earlier.objects]
        remaining = [changed.get(o.name, o) for o in earlier.objects if o.name not in self.removed]
        if self.camera is not None:
            remaining = moved_with_camera(
                remaining, earlier.camera, self.camera, size, placed=changed
            )
        added = [obj for obj in self.objects if obj.name not in names]
        data = {
            "observations": self.observations or earlier.observations,
            "camera": self.camera or earlier.camera,
            "objects": [*remaining, *added],
        }
        # Validate objects again, because their parents and occluders must exist.
        return ParsedScene.model_validate({key: _plain(value) for key, value in data.items()})


def _plain(value: object) -> object:
    if isinstance(value, BaseModel):
        return value.model_dump()
    return [_plain(entry) for entry in value] if isinstance(value, list) else value


def to_tree(response: ParsedScene, photo: Photo) -> SceneTree:
    """Convert a response into a scene tree in pixels of the upright original.

    2D boxes are clipped at the picture's edges.

    Args:
        response: the response, with boxes in pixels of the resized picture.
        photo: the photograph.

    Raises:
        SpecError: a box lies outside the picture, or the tree is invalid; the message is written
            for the model.
    """
    size, original = photo.size, photo.original_size
    outside = [
        f"object {obj.name}: box {corners(obj.box)} lies outside the picture, which is "
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
        return build_tree(response.camera, response.objects, per_pixel, original, clip=True)
    except ValidationError as error:
        raise SpecError(error_line(error)) from None


def _problems(response: ParsedScene) -> list[str]:
    """List the errors that the tree's own validation does not report."""
    spelled: dict[str, str] = {}
    parts = {obj.name: [part.part for part in obj.articulation] for obj in response.objects}
    problems = []
    for obj in response.objects:
        if spelled.setdefault(obj.name.lower(), obj.name) != obj.name:
            other = spelled[obj.name.lower()]
            problems.append(f"object {obj.name}: {other} differs by case alone")
        links = parts.get(obj.parent or "", [])
        if obj.parent_link is not None and obj.parent in parts and obj.parent_link not in links:
            problems.append(
                f"object {obj.name}: parent_link {plain_text(obj.parent_link, MAX_NAME)!r} is not "
                f"in the articulation of {obj.parent}, which has "
                f"{', '.join(links) or 'no movable parts'}"
            )
    return problems

"""Shapes of programs, poses and bounding boxes of shapes, and named points of bounding boxes."""

from collections.abc import Sequence
from typing import Any, no_type_check

import numpy as np
from numpy.typing import NDArray

from .. import spec as S
from ..spec.convex import box_around
from ..spec.pose import IDENTITY, Pose, from_rpy, pose
from . import validate
from .sdk_types import Vec3

Bounds = tuple[NDArray, NDArray]
"""Lowest and highest corner of a bounding box [m], each of shape [3]."""

_SIDES = {
    "front": (0, 1),
    "back": (0, -1),
    "left": (1, 1),
    "right": (1, -1),
    "top": (2, 1),
    "bottom": (2, -1),
    **{f"{sign}{axis}": (k, int(sign + "1")) for k, axis in enumerate("xyz") for sign in "+-"},
}

_DIRECTIONS = {**_SIDES, "up": _SIDES["top"], "down": _SIDES["bottom"]}


@no_type_check
class Shape:
    """A solid that can be added to a part."""

    __slots__ = ("_pose", "_spec")

    def __init__(self, spec: Any, origin: Pose | None = None) -> None:
        self._spec: S.Shape = spec
        self._pose = pose() if origin is None else origin

    def __repr__(self) -> str:
        return repr(self._spec)

    @property
    def size(self) -> tuple[float, float, float]:
        """Edge lengths [m] of the axis-aligned bounding box, after rotations by `moved`."""
        low, high = bounds_of(self, pose())
        x, y, z = (high - low).tolist()
        return x, y, z

    @property
    def volume(self) -> float:
        """Volume of the solid [m^3]."""
        return self._spec.volume()

    def distance(self, point: Vec3) -> float:
        """Return the signed distance from the shape's surface to a point [m], negative inside."""
        local = self._pose.inverse().apply(validate.vector(point, "distance: point"))
        return float(self._spec.signed_distance(local)[0])

    def moved(
        self, at: Vec3 = (0.0, 0.0, 0.0), rpy: Vec3 = (0.0, 0.0, 0.0), *, by: str = ""
    ) -> "Shape":
        """Return a copy of the shape, rotated by `rpy` and placed at `at` as by `Part.add`."""
        return Shape(self._spec, placed(self, at, rpy, by, "moved"))


@no_type_check
def placed(shape: Shape, at: Sequence[float], rpy: Sequence[float], by: str, context: str) -> Pose:
    """Return the pose that puts a shape's origin or anchor at a point.

    Args:
        shape: the shape.
        at: the point in the object's frame [m], shape [3].
        rpy: fixed-axis roll, pitch and yaw [rad], shape [3].
        by: anchor of the rotated shape's bounding box; if empty, the shape's origin lies at the
            point.
        context: name of the call, for messages.
    """
    position = np.array(validate.vector(at, f"{context}: at"))
    rotation = from_rpy(*validate.rotation(rpy, f"{context}: rpy"))
    if by:
        bounds = bounds_of(shape, pose((0, 0, 0), rotation))
        position = position - anchor_of(bounds, by, f"{context}: by")
    origin, local = pose(position, rotation), shape._pose
    if tuple(local.quat.tolist()) == IDENTITY and not local.pos.any():
        return origin
    return origin.then(local)


def bounds_of(shape: Shape, at: Pose) -> Bounds:
    """Return the bounding box of a shape at a pose."""
    return bounds_at(shape._spec, at.then(shape._pose))


def bounds_at(spec: S.Shape, at: Pose) -> Bounds:
    """Return the bounding box of a shape's spec at a pose."""
    return enclosing(
        [box_around(piece, at.then(pose(piece.pos, piece.quat))) for piece in spec.pieces()]
    )


def enclosing(boxes: Sequence[Bounds]) -> Bounds:
    """Return the smallest bounding box that contains all given bounding boxes."""
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)


def anchor_of(bounds: Bounds, where: Any, argument: str) -> NDArray:
    """Return a named point of a bounding box [m], shape [3].

    Examples of names are "top", "left.front", "-x.bottom" and "centre". Along each axis that the
    name does not mention, the point lies in the middle.
    """
    if not isinstance(where, str):
        raise TypeError(
            f"{argument} must be a string such as 'top', got {validate.formatted(where)}"
        )
    low, high = bounds
    point = (low + high) / 2
    for axis, sign in _named(validate.text(where, argument).split("."), argument).items():
        point[axis] = high[axis] if sign > 0 else low[axis]
    return point


def _named(words: list[str], argument: str) -> dict[int, int]:
    """Return the sign of each axis that the words of an anchor mention, by axis index."""
    signs: dict[int, int] = {}
    for word in words:
        if word == "centre":
            continue
        if word not in _SIDES:
            raise ValueError(
                f"{argument} takes {', '.join(_SIDES)} or centre, joined by dots as in "
                f"'left.bottom', or 'left.hinge'; got {validate.formatted('.'.join(words))}"
            )
        axis, sign = _SIDES[word]
        if axis in signs:
            raise ValueError(
                f"{argument} {validate.formatted('.'.join(words))} names one direction twice"
            )
        signs[axis] = sign
    return signs


def is_hinge(where: Any) -> bool:
    """Return True if an anchor names a hinge line, such as "left.hinge"."""
    return isinstance(where, str) and "hinge" in where.split(".")


def hinge_of(
    bounds: Bounds, others: Bounds | None, where: str, argument: str
) -> tuple[NDArray, NDArray]:
    """Return the hinge line at an edge of a flat part, such as a door or a lid.

    The line runs along the named edge, on the face towards the other parts.

    Args:
        bounds: bounding box of the flat part, whose shortest edge is the thickness.
        others: bounding box of the parts that the flat part is attached to and opens away from. If
            None, the flat part opens to the front, to the left or upwards.
        where: anchor such as "left.hinge".
        argument: name of the argument that contains the anchor, for messages.

    Returns:
        The center of the edge [m], shape [3], and the axis about which positive angles open the
        part, shape [3].
    """
    words = [word for word in validate.text(where, argument).split(".") if word != "hinge"]
    edges = _named(words, argument)
    low, high = bounds
    thin = int(np.argmin(high - low))
    if len(edges) != 1 or thin in edges:
        raise ValueError(
            f"{argument} names one edge of a flat part, such as 'left.hinge'; this part is "
            f"thinnest from {('back to front', 'right to left', 'bottom to top')[thin]}, "
            f"got {validate.formatted(where)}"
        )
    middle = (low + high) / 2
    outward = 1
    if others is not None and middle[thin] < (others[0][thin] + others[1][thin]) / 2:
        outward = -1
    ((edge, side),) = edges.items()
    point = middle.copy()
    point[edge] = high[edge] if side > 0 else low[edge]
    point[thin] = low[thin] if outward > 0 else high[thin]
    # Positive angles move the edge opposite to the named edge outwards.
    axis = np.cross(-side * np.eye(3)[edge], outward * np.eye(3)[thin])
    return point, axis + 0.0


def direction(value: Any, argument: str) -> tuple[float, float, float]:
    """Return a direction, given as three numbers or as a word such as "front", "up" or "-y"."""
    if not isinstance(value, str):
        return validate.vector(value, argument)
    if value not in _DIRECTIONS:
        raise ValueError(
            f"{argument} must be (x, y, z) or one of {', '.join(_DIRECTIONS)}, "
            f"got {validate.formatted(value)}"
        )
    axis, sign = _DIRECTIONS[value]
    x, y, z = (sign * np.eye(3)[axis] + 0.0).tolist()
    return x, y, z

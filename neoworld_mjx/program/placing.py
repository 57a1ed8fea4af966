"""A shape in a program's hands, its bounding box, and the named points of boxes."""

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
"""Lowest and highest corner [3] m."""
MAX_ANGLE_RAD = 200.0

_SIDES = {
    "front": (0, 1),
    "back": (0, -1),
    "left": (1, 1),
    "right": (1, -1),
    "top": (2, 1),
    "bottom": (2, -1),
    **{f"{sign}{axis}": (k, int(sign + "1")) for k, axis in enumerate("xyz") for sign in "+-"},
}

_WAYS = {**_SIDES, "up": _SIDES["top"], "down": _SIDES["bottom"]}


@no_type_check
class Shape:
    """A solid that a part may be given, with the size of its bounding box."""

    __slots__ = ("_pose", "_spec")

    def __init__(self, described: Any, at: Pose | None = None) -> None:
        self._spec: S.Shape = described
        self._pose = pose() if at is None else at

    def __repr__(self) -> str:
        return repr(self._spec)

    @property
    def size(self) -> tuple[float, float, float]:
        """Edge lengths [m] of the bounding box in the shape's own frame."""
        low, high = bounds_of(self, pose())
        x, y, z = (high - low).tolist()
        return x, y, z

    @property
    def volume(self) -> float:
        """Volume of the solid [m^3]."""
        return self._spec.volume()

    def distance(self, point: Vec3) -> float:
        """Return how far [m] a point lies from the surface, negative inside."""
        where = self._pose.inverse().apply(validate.vector(point, "distance: point"))
        return float(self._spec.signed_distance(where)[0])

    def moved(
        self, at: Vec3 = (0.0, 0.0, 0.0), rpy: Vec3 = (0.0, 0.0, 0.0), *, by: str = ""
    ) -> "Shape":
        """Return the shape turned by `rpy` and put at `at`, as `Part.add` would put it."""
        return Shape(self._spec, placed(self, at, rpy, by, "moved"))


@no_type_check
def placed(shape: Shape, at: Sequence[float], rpy: Sequence[float], by: str, what: str) -> Pose:
    """Return the pose of a shape's description when its origin, or its point `by`, goes to `at`."""
    where = np.array(validate.vector(at, f"{what}: at"))
    turned = from_rpy(*validate.vector(rpy, f"{what}: rpy", MAX_ANGLE_RAD))
    if by:
        bounds = bounds_of(shape, pose((0, 0, 0), turned))
        where = where - anchor_of(bounds, by, f"{what}: by")
    found = pose(where, turned)
    own = shape._pose
    if tuple(own.quat.tolist()) == IDENTITY and not own.pos.any():
        return found
    return found.then(own)


def bounds_of(shape: Shape, at: Pose) -> Bounds:
    """Return the bounding box (low [3], high [3]) [m] of a shape at a pose."""
    return bounds_at(shape._spec, at.then(shape._pose))


def bounds_at(described: S.Shape, at: Pose) -> Bounds:
    """Return the bounding box of a described shape at its pose."""
    boxes = [
        box_around(piece, at.then(pose(piece.pos, piece.quat))) for piece in described.pieces()
    ]
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)


def anchor_of(bounds: Bounds, where: Any, what: str) -> NDArray:
    """Return a named point of a bounding box [3] m: "top", "left.front", "-x.bottom", "centre".

    A direction that is not named stays in the middle.
    """
    if not isinstance(where, str):
        raise TypeError(f"{what} must be a string such as 'top', got {validate.shown(where)}")
    low, high = bounds
    point = (low + high) / 2
    for axis, sign in _named(validate.text(where, what).split("."), what).items():
        point[axis] = high[axis] if sign > 0 else low[axis]
    return point


def _named(words: list[str], what: str) -> dict[int, int]:
    """Return the sign of every direction that is named."""
    found: dict[int, int] = {}
    for word in words:
        if word == "centre":
            continue
        if word not in _SIDES:
            raise ValueError(
                f"{what} takes {', '.join(_SIDES)} or centre, joined by dots as in "
                f"'left.bottom', or 'left.hinge'; got {validate.shown('.'.join(words))}"
            )
        axis, sign = _SIDES[word]
        if axis in found:
            raise ValueError(f"{what} {validate.shown('.'.join(words))} names one direction twice")
        found[axis] = sign
    return found


def is_hinge(where: Any) -> bool:
    """Tell whether an anchor names a hinge line, such as "left.hinge"."""
    return isinstance(where, str) and "hinge" in where.split(".")


def hinge_of(
    bounds: Bounds, others: Bounds | None, where: str, what: str
) -> tuple[NDArray, NDArray]:
    """Find the line about which a flat part, a door or a lid, turns at one of its edges.

    The part is thin along one direction and opens to the side that is away from the others; the
    line runs along the named edge, on the face that is towards them.

    Args:
        bounds: of the part.
        others: of what it is hung on; without it, it opens to the front, the left or upwards.
        where: such as "left.hinge".
        what: for messages.

    Returns:
        A point of the line, in the middle of the edge [3] m, and the axis [3]; positive opens.
    """
    words = [word for word in validate.text(where, what).split(".") if word != "hinge"]
    named = _named(words, what)
    low, high = bounds
    thin = int(np.argmin(high - low))
    if len(named) != 1 or thin in named:
        raise ValueError(
            f"{what} names one edge of a flat part, such as 'left.hinge'; this part is thinnest "
            f"from {('back to front', 'right to left', 'bottom to top')[thin]}, "
            f"got {validate.shown(where)}"
        )
    middle = (low + high) / 2
    outward = 1
    if others is not None and middle[thin] < (others[0][thin] + others[1][thin]) / 2:
        outward = -1
    ((edge, side),) = named.items()
    point = middle.copy()
    point[edge] = high[edge] if side > 0 else low[edge]
    point[thin] = low[thin] if outward > 0 else high[thin]
    # The far edge, opposite to the named one, shall move outwards.
    axis = np.cross(-side * np.eye(3)[edge], outward * np.eye(3)[thin])
    return point, axis + 0.0


def direction(value: Any, what: str) -> tuple[float, float, float]:
    """Take an axis: three numbers, or a direction in words such as "front", "up" or "-y"."""
    if not isinstance(value, str):
        return validate.vector(value, what)
    if value not in _WAYS:
        raise ValueError(
            f"{what} must be (x, y, z) or one of {', '.join(_WAYS)}, got {validate.shown(value)}"
        )
    axis, sign = _WAYS[value]
    x, y, z = (sign * np.eye(3)[axis] + 0.0).tolist()
    return x, y, z

"""A shape in a program's hands, its bounding box, and the named points of boxes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import spec as S
from ..spec.convex import box_around
from ..spec.pose import Pose, pose
from . import arguments as take

Bounds = tuple[NDArray, NDArray]
"""Lowest and highest corner [3] m."""

_SIDES = {
    "front": (0, 1),
    "back": (0, -1),
    "left": (1, 1),
    "right": (1, -1),
    "top": (2, 1),
    "bottom": (2, -1),
    **{f"{sign}{axis}": (k, int(sign + "1")) for k, axis in enumerate("xyz") for sign in "+-"},
}


class Shape:
    """A solid that a part may be given, with the size of its bounding box."""

    __slots__ = ("_spec",)

    def __init__(self, described: Any) -> None:
        self._spec: S.Shape = described

    def __repr__(self) -> str:
        return repr(self._spec)

    @property
    def size(self) -> tuple[float, float, float]:
        """Edge lengths [m] of the bounding box in the shape's own frame."""
        low, high = bounds_of(self, pose())
        x, y, z = (high - low).tolist()
        return x, y, z


def bounds_of(shape: Shape, at: Pose) -> Bounds:
    """Return the bounding box (low [3], high [3]) [m] of a shape at a pose."""
    boxes = [
        box_around(piece, at.then(pose(piece.pos, piece.quat))) for piece in shape._spec.pieces()
    ]
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)


def anchor_of(bounds: Bounds, where: Any, what: str) -> NDArray:
    """Return a named point of a bounding box [3] m: "top", "left.front", "-x.bottom", "centre".

    A direction that is not named stays in the middle.
    """
    if not isinstance(where, str):
        raise TypeError(f"{what} must be a string such as 'top', got {take.shown(where)}")
    low, high = bounds
    point = (low + high) / 2
    named: set[int] = set()
    for word in take.text(where, what).split("."):
        if word == "centre":
            continue
        if word not in _SIDES:
            raise ValueError(
                f"{what} takes {', '.join(_SIDES)} or centre, joined by dots as in "
                f"'left.bottom'; got {take.shown(where)}"
            )
        axis, sign = _SIDES[word]
        if axis in named:
            raise ValueError(f"{what} {where!r} names one direction twice")
        named.add(axis)
        point[axis] = high[axis] if sign > 0 else low[axis]
    return point

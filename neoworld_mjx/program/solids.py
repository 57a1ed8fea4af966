"""The shapes that programs place: checked arguments in, shapes of the description out.

Every function says where the shape's own origin lies. Sizes are full lengths in metres.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import spec as S
from ..spec.convex import extent
from ..spec.pose import Pose, conjugate, pose, rotate
from ..spec.shapes import MAX_SECTORS, MIN_SECTORS
from . import arguments as take
from .session import current

Bounds = tuple[NDArray, NDArray]

MAX_POINTS = 64
MAX_SHAPE_PIECES = 1200
_FACES = ("+x", "-x", "+y", "-y", "+z", "-z")
_SIDES = {
    "front": (0, 1),
    "back": (0, -1),
    "left": (1, 1),
    "right": (1, -1),
    "top": (2, 1),
    "bottom": (2, -1),
    **{face: ("xyz".index(face[1]), 1 if face[0] == "+" else -1) for face in _FACES},
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


def box(size: Sequence[float]) -> Shape:
    """Make a box with full edge lengths (x, y, z), centred at its origin."""
    return _made(S.Box, 1, size=take.lengths(size, "box size"))


def sphere(radius: float) -> Shape:
    """Make a ball, centred."""
    return _made(S.Sphere, 1, radius=take.length(radius, "sphere radius"))


def capsule(radius: float, length: float) -> Shape:
    """Make a capsule along z, centred; `length` is of the straight part, without the round ends."""
    return _made(
        S.Capsule,
        1,
        radius=take.length(radius, "capsule radius"),
        length=take.length(length, "capsule length"),
    )


def cylinder(radius: float, height: float) -> Shape:
    """Make a solid cylinder along z, centred."""
    return _made(
        S.Cylinder,
        1,
        radius=take.length(radius, "cylinder radius"),
        height=take.length(height, "cylinder height"),
    )


def ellipsoid(radii: Sequence[float]) -> Shape:
    """Make an ellipsoid with semi-axes (x, y, z), centred."""
    return _made(S.Ellipsoid, 1, radii=take.lengths(radii, "ellipsoid radii"))


def prism(outline: Sequence[Sequence[float]], height: float) -> Shape:
    """Extrude a convex outline of (x, y) points along z from -height/2 to height/2."""
    return _made(
        S.Prism,
        1,
        outline=take.points(outline, "prism outline", 3, MAX_POINTS),
        height=take.length(height, "prism height"),
    )


def hollow_box(size: Sequence[float], wall: float, open: str | Sequence[str] = "+z") -> Shape:
    """Make a box of walls of one thickness, centred, with the named faces left open."""
    faces = [open] if isinstance(open, str) else take.sequence(open, "hollow_box open", 0, 5)
    for face in faces:
        if face not in _FACES:
            raise ValueError(
                f"hollow_box open takes faces {', '.join(_FACES)}, got {take.shown(face)}"
            )
    return _made(
        S.HollowBox,
        6,
        size=take.lengths(size, "hollow_box size"),
        wall=take.length(wall, "hollow_box wall"),
        open=tuple(dict.fromkeys(faces)),
    )


def lathe(
    profile: Sequence[Sequence[float]], thickness: float | None = None, sectors: int = 16
) -> Shape:
    """Revolve a profile of (radius, z) points about the shape's z axis.

    With `thickness` the profile is the outer face of a shell, from the foot to the rim, and the
    wall grows inwards and upwards: a cup, a bowl, a plate. Without it the profile bounds a solid.
    """
    outline = take.points(profile, "lathe profile", 2, MAX_POINTS)
    count = take.whole(sectors, "lathe sectors", MIN_SECTORS, MAX_SECTORS)
    wall = None if thickness is None else take.length(thickness, "lathe thickness")
    bands = len(outline) - 1
    return _made(
        S.Lathe,
        bands if wall is None else bands * count,
        profile=outline,
        thickness=wall,
        sectors=count,
    )


def bounds_of(shape: Shape, at: Pose) -> Bounds:
    """Return the bounding box (low [3], high [3]) [m] of a shape at a pose."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for piece in shape._spec.pieces():
        world = at.then(pose(piece.pos, piece.quat))
        back = conjugate(world.quat)
        for axis in range(3):
            d = rotate(back, np.eye(3)[axis])
            high[axis] = max(high[axis], world.pos[axis] + extent(piece, d))
            low[axis] = min(low[axis], world.pos[axis] - extent(piece, -d))
    return low, high


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


def _made(model: Any, pieces: int, **fields: Any) -> Shape:
    what = model.model_fields["type"].default
    if pieces > MAX_SHAPE_PIECES:
        raise ValueError(
            f"{what} would need {pieces} convex pieces, at most {MAX_SHAPE_PIECES} are allowed: "
            f"give it fewer points or sectors"
        )
    current().use("pieces built", pieces, 4 * current().max_pieces)
    return Shape(take.described(model, what, **fields))

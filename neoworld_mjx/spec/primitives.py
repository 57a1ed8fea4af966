"""Base of all shapes, and the primitive shapes.

The primitive shapes are box, sphere, capsule, cylinder, ellipsoid, convex prism and hollow box.
"""

from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base import Length, Meters, ScalableSpec
from .convex import Piece, mass_properties, prism
from .dimensions import LENGTH, UNSCALED
from .pose import ArrayLike
from .triangles import (
    BALL_SECTORS,
    SECTORS,
    distance_to_triangles,
    enclosed_volume,
    extruded_outline,
    meridian,
    revolved,
)

Point2 = Annotated[tuple[Meters, Meters], LENGTH]
Face = Literal["+x", "-x", "+y", "-y", "+z", "-z"]

MIN_SECTORS, MAX_SECTORS = 6, 64
Sectors = Annotated[int, Field(ge=MIN_SECTORS, le=MAX_SECTORS), UNSCALED]


class BaseShape(ScalableSpec):
    """Base of all shapes.

    A shape defines its convex pieces and its surface. Volume and distance follow from the surface,
    so they describe the true solid, not its colliders. A primitive has a formula for its volume.
    """

    def build_pieces(self) -> list[Piece]:
        """Compute the convex pieces; see `pieces`."""
        raise NotImplementedError

    def pieces(self) -> list[Piece]:
        """Return the convex pieces, which do not overlap, in the shape's frame."""
        return list(_shared_pieces(self))  # pyright: ignore[reportArgumentType] as in `surface`

    def primitive(self) -> Piece | None:
        """Return the shape as a primitive piece, or None if it is not a primitive."""
        return None

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Compute the surface; see `surface`."""
        raise NotImplementedError

    def surface(self) -> tuple[NDArray, NDArray]:
        """Return the closed surface in the shape's frame; normals point outwards.

        Rendering and exported visuals use the surface, which is one watertight mesh. Physics uses
        the pieces, which may be coarser.

        Returns:
            Vertices [m], float64 [v, 3], and triangles, int64 [f, 3], counterclockwise as seen from
            outside. The arrays are shared and read-only.
        """
        return _shared_surface(self)  # pyright: ignore[reportArgumentType] frozen models have a hash

    def volume(self) -> float:
        """Return the volume [m^3]."""
        return enclosed_volume(*self.surface())

    def signed_distance(self, points: ArrayLike) -> NDArray:
        """Return the distances [m] of points [m] to the surface, negative inside, shape [n]."""
        return distance_to_triangles(as_points(points), *self.surface())


class Primitive(BaseShape):
    """Base of shapes that correspond to a geom type of MuJoCo."""

    def primitive(self) -> Piece:
        """Return the shape as a piece."""
        raise NotImplementedError

    def build_pieces(self) -> list[Piece]:
        """Return the primitive as the only piece."""
        return [self.primitive()]

    def volume(self) -> float:
        """Return the volume [m^3]."""
        return mass_properties(self.primitive())[0]


@lru_cache(maxsize=1024)
def _shared_pieces(shape: BaseShape) -> tuple[Piece, ...]:
    return tuple(shape.build_pieces())


@lru_cache(maxsize=1024)
def _shared_surface(shape: BaseShape) -> tuple[NDArray, NDArray]:
    vertices, faces = shape.build_surface()
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return vertices, faces


def as_points(points: ArrayLike) -> NDArray:
    """Return points as an array [n, 3]."""
    return np.atleast_2d(np.asarray(points, float))


Edges = tuple[Length, Length, Length]
"""Full edge lengths along x, y, z [m]."""


class Box(Primitive):
    """A centered box with full edge lengths along x, y and z."""

    type: Literal["box"] = "box"
    size: Edges

    def primitive(self) -> Piece:
        """Return the box as a piece."""
        return Piece("box", tuple(v / 2 for v in self.size))

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Return the 12 triangles of the box."""
        x, y, z = self.size
        return extruded_outline(np.array([[-x, -y], [x, -y], [x, y], [-x, y]]) / 2, z)


class Sphere(Primitive):
    """A centered sphere."""

    type: Literal["sphere"] = "sphere"
    radius: Length

    def primitive(self) -> Piece:
        """Return the sphere as a piece."""
        return Piece("sphere", (self.radius, 0.0, 0.0))

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Revolve a meridian."""
        return revolved(meridian(self.radius, 0.0), BALL_SECTORS)


class Capsule(Primitive):
    """A centered capsule along z; `length` excludes the two hemispheres."""

    type: Literal["capsule"] = "capsule"
    radius: Length
    length: Length

    def primitive(self) -> Piece:
        """Return the capsule as a piece."""
        return Piece("capsule", (self.radius, self.length / 2, 0.0))

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Revolve a meridian."""
        return revolved(meridian(self.radius, self.length / 2), BALL_SECTORS)


class Cylinder(Primitive):
    """A centered cylinder along z."""

    type: Literal["cylinder"] = "cylinder"
    radius: Length
    height: Length

    def primitive(self) -> Piece:
        """Return the cylinder as a piece."""
        return Piece("cylinder", (self.radius, self.height / 2, 0.0))

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Revolve a rectangle."""
        r, h = self.radius, self.height / 2
        return revolved(np.array([[0, -h], [r, -h], [r, h], [0, h]]), SECTORS)


class Ellipsoid(Primitive):
    """A centered ellipsoid with semi-axes along x, y and z."""

    type: Literal["ellipsoid"] = "ellipsoid"
    radii: tuple[Length, Length, Length]

    def primitive(self) -> Piece:
        """Return the ellipsoid as a piece."""
        return Piece("ellipsoid", self.radii)

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Stretch a sphere."""
        vertices, faces = revolved(meridian(1.0, 0.0), BALL_SECTORS)
        return vertices * np.array(self.radii), faces


class Prism(BaseShape):
    """A convex outline of (x, y) points, extruded along z from -height/2 to height/2."""

    type: Literal["prism"] = "prism"
    outline: tuple[Point2, ...] = Field(min_length=3, max_length=64)
    height: Length

    @model_validator(mode="after")
    def _convex(self) -> "Prism":
        p = np.array(self.outline)
        edge = np.roll(p, -1, axis=0) - p
        turn = _cross2(edge, np.roll(edge, -1, axis=0))
        if not (np.all(turn > 0) or np.all(turn < 0)):
            raise ValueError(
                "prism outline must be strictly convex, without repeated or collinear points"
            )
        # A star polygon turns the same way at every corner, but winds more than once.
        if abs(np.sum(np.arctan2(turn, np.sum(edge * np.roll(edge, -1, axis=0), axis=1)))) > 7:
            raise ValueError("prism outline must go around once")
        return self

    def build_pieces(self) -> list[Piece]:
        """Return the prism as the only piece."""
        return [prism(np.array(self.outline), self.height)]

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Build both ends and the sides."""
        return extruded_outline(np.array(self.outline), self.height)


class HollowBox(BaseShape):
    """A centered box with walls of equal thickness on all faces except `open`, such as a drawer."""

    type: Literal["hollow_box"] = "hollow_box"
    size: Edges
    wall: Length
    open: tuple[Face, ...] = ("+z",)

    @model_validator(mode="after")
    def _thin(self) -> "HollowBox":
        if 2 * self.wall >= min(self.size):
            raise ValueError(f"wall {self.wall} leaves no cavity in a box of size {self.size}")
        if len(set(self.open)) == 6:
            raise ValueError("a hollow box with all six faces open has no walls")
        return self

    def build_pieces(self) -> list[Piece]:
        """Return the walls, cut so that they do not overlap at the edges."""
        low, high = -np.array(self.size) / 2, np.array(self.size) / 2
        walls = []
        for axis, letter in ((2, "z"), (1, "y"), (0, "x")):
            for sign, side in (("-", low), ("+", high)):
                if f"{sign}{letter}" in self.open:
                    continue
                a, b = low.copy(), high.copy()
                if sign == "-":
                    b[axis] = a[axis] + self.wall
                    inner = b[axis]
                else:
                    a[axis] = b[axis] - self.wall
                    inner = a[axis]
                half, centre = (b - a) / 2, (a + b) / 2
                walls.append(Piece("box", tuple(half.tolist()), tuple(centre.tolist())))
                # Later walls lie between the earlier ones.
                side[axis] = inner
        return walls

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Return the outer faces of the filled cells of a grid that the walls define."""
        grid, cavity = [], []
        for axis, letter in enumerate("xyz"):
            half = self.size[axis] / 2
            low = f"-{letter}" in self.open
            high = f"+{letter}" in self.open
            lines = [-half, *([] if low else [-half + self.wall])]
            cavity.append(len(lines) - 1)
            grid.append(np.array([*lines, *([] if high else [half - self.wall]), half]))
        cells = [len(line) - 1 for line in grid]
        filled = np.zeros([n + 2 for n in cells], bool)
        filled[1:-1, 1:-1, 1:-1] = True
        filled[tuple(c + 1 for c in cavity)] = False
        corners: dict[tuple[int, int, int], int] = {}
        points: list[list[float]] = []
        faces: list[list[int]] = []
        for cell in np.argwhere(filled):
            for axis in range(3):
                for side in (0, 1):
                    beyond = cell.copy()
                    beyond[axis] += 2 * side - 1
                    if filled[tuple(beyond)]:
                        continue
                    u, v = (axis + 1) % 3, (axis + 2) % 3
                    quad = []
                    for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
                        corner = cell - 1
                        corner[axis] += side
                        corner[u] += du
                        corner[v] += dv
                        key = (int(corner[0]), int(corner[1]), int(corner[2]))
                        if key not in corners:
                            corners[key] = len(points)
                            points.append([float(grid[i][key[i]]) for i in range(3)])
                        quad.append(corners[key])
                    if side == 0:
                        quad.reverse()
                    faces += [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
        return np.array(points), np.array(faces)


def _cross2(a: NDArray, b: NDArray) -> NDArray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

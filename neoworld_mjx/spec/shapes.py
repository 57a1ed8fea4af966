"""Shapes that parts are made of: parametric, scalable, each the sum of its convex pieces.

A shape's pieces do not overlap, so volume and inertia are sums over them, and they are the
colliders as well: cavities stay open. Lengths are in metres; each class states its frame.
"""

from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base_shape import MAX_SECTORS, MIN_SECTORS, BaseShape, Face, Length, Number, Point2
from .convex import Piece, polytope
from .csg import CSG, Placed
from .extruded import Extrusion, RoundedBox
from .mesh import Mesh
from .swept import Sweep


class Box(BaseShape):
    """A box, centred, with full edge lengths along x, y, z."""

    type: Literal["box"] = "box"
    size: tuple[Length, Length, Length]

    def pieces(self) -> list[Piece]:
        """Return the box itself."""
        return [Piece("box", tuple(v / 2 for v in self.size))]


class Sphere(BaseShape):
    """A ball, centred."""

    type: Literal["sphere"] = "sphere"
    radius: Length

    def pieces(self) -> list[Piece]:
        """Return the ball itself."""
        return [Piece("sphere", (self.radius, 0.0, 0.0))]


class Capsule(BaseShape):
    """A capsule along z, centred; `length` is that of the cylinder between the two half balls."""

    type: Literal["capsule"] = "capsule"
    radius: Length
    length: Length

    def pieces(self) -> list[Piece]:
        """Return the capsule itself."""
        return [Piece("capsule", (self.radius, self.length / 2, 0.0))]


class Cylinder(BaseShape):
    """A cylinder along z, centred."""

    type: Literal["cylinder"] = "cylinder"
    radius: Length
    height: Length

    def pieces(self) -> list[Piece]:
        """Return the cylinder itself."""
        return [Piece("cylinder", (self.radius, self.height / 2, 0.0))]


class Ellipsoid(BaseShape):
    """An ellipsoid, centred, with semi-axes along x, y, z."""

    type: Literal["ellipsoid"] = "ellipsoid"
    radii: tuple[Length, Length, Length]

    def pieces(self) -> list[Piece]:
        """Return the ellipsoid itself."""
        return [Piece("ellipsoid", self.radii)]


class Prism(BaseShape):
    """A convex outline in x, y extruded along z from -height/2 to height/2."""

    type: Literal["prism"] = "prism"
    outline: tuple[Point2, ...] = Field(min_length=3, max_length=64)
    height: Length

    @model_validator(mode="after")
    def _convex(self) -> Self:
        p = np.array(self.outline)
        edge = np.roll(p, -1, axis=0) - p
        turn = _cross2(edge, np.roll(edge, -1, axis=0))
        if not (np.all(turn > 0) or np.all(turn < 0)):
            raise ValueError(
                "prism outline must be strictly convex, without repeated or collinear points"
            )
        # A star polygon turns the same way at every corner too, but more than once around.
        if abs(np.sum(np.arctan2(turn, np.sum(edge * np.roll(edge, -1, axis=0), axis=1)))) > 7:
            raise ValueError("prism outline must go around once")
        return self

    def pieces(self) -> list[Piece]:
        """Return the prism itself."""
        p = np.array(self.outline)
        h = self.height / 2
        top = np.column_stack([p, np.full(len(p), h)])
        return [polytope(np.vstack([top, top * [1, 1, -1]]))]


class HollowBox(BaseShape):
    """A box with walls of one thickness and the named faces left open, centred; a drawer or bin."""

    type: Literal["hollow_box"] = "hollow_box"
    size: tuple[Length, Length, Length]
    wall: Length
    open: tuple[Face, ...] = ("+z",)

    @model_validator(mode="after")
    def _thin(self) -> Self:
        if 2 * self.wall >= min(self.size):
            raise ValueError(f"wall {self.wall} leaves no cavity in a box of size {self.size}")
        if len(set(self.open)) == 6:
            raise ValueError("a hollow box with all six faces open has no walls")
        return self

    def pieces(self) -> list[Piece]:
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
                    low_next = b[axis]
                else:
                    a[axis] = b[axis] - self.wall
                    low_next = a[axis]
                half, centre = (b - a) / 2, (a + b) / 2
                walls.append(Piece("box", tuple(half.tolist()), tuple(centre.tolist())))
                # What remains for the walls still to come is the inside of this one.
                side[axis] = low_next
        return walls


class Lathe(BaseShape):
    """A profile of (r, z) points revolved about z.

    With `thickness` the profile is the outer face of a shell, walked from the foot to the rim; the
    wall grows to its left, which is inwards and upwards (a cup, a bowl, a saucer). Without it the
    profile bounds a solid and z must not decrease. Pieces are convex: frusta for a solid and for what
    lies below the flat inner floor of a shell, wedges of each band above. Their corners lie on the true surface of revolution, so they stay within
    r (1 - cos(pi / sectors)) of it.
    """

    type: Literal["lathe"] = "lathe"
    profile: tuple[Point2, ...] = Field(min_length=2, max_length=64)
    thickness: Length | None = None
    sectors: int = Field(default=16, ge=MIN_SECTORS, le=MAX_SECTORS)
    oval: float = Field(default=1.0, ge=0.05, le=20.0, allow_inf_nan=False)
    """Size along y over size along x: the whole shape, wall included, is stretched along y."""

    @model_validator(mode="after")
    def _sane(self) -> Self:
        p = np.array(self.profile)
        if np.any(p[:, 0] < 0):
            raise ValueError("lathe radii must not be negative")
        if np.any(np.all(np.diff(p, axis=0) == 0, axis=1)):
            raise ValueError("lathe profile repeats a point")
        if self.thickness is None and np.any(np.diff(p[:, 1]) < 0):
            raise ValueError("the z of a solid lathe's profile must not decrease")
        if self.thickness is not None and np.any(p[1:, 0] == 0):
            raise ValueError("a lathe shell may touch the axis only at its first point")
        if not self.pieces():
            raise ValueError("lathe has no volume")
        return self

    def inner(self) -> NDArray:
        """Return the inner face of the shell, shape [len(profile), 2]: the profile, offset."""
        p = np.array(self.profile)
        d = np.diff(p, axis=0)
        n = np.column_stack([-d[:, 1], d[:, 0]]) / np.linalg.norm(d, axis=1, keepdims=True)
        before, after = np.vstack([n[:1], n]), np.vstack([n, n[-1:]])
        mitre = (before + after) / (1 + np.sum(before * after, axis=1, keepdims=True))
        q = p + (self.thickness or 0.0) * mitre
        q[:, 0] = np.maximum(q[:, 0], 0.0)
        if p[0, 0] == 0:
            q[0, 0] = 0.0
        return q

    def pieces(self) -> list[Piece]:
        """Return frusta (solid) or a disc and wedges (shell)."""
        turn = 2 * np.pi / self.sectors
        pieces = []
        for piece, repeats in self.distinct_pieces():
            pieces.append(piece)
            corners = np.array(piece.vertices) / [1.0, self.oval, 1.0]
            for k in range(1, repeats):
                c, s = np.cos(k * turn), np.sin(k * turn)
                x, y, z = corners.T
                around = np.column_stack([c * x - s * y, self.oval * (s * x + c * y), z])
                pieces.append(polytope(around))
        return pieces

    def distinct_pieces(self) -> list[tuple[Piece, int]]:
        """Return the pieces up to turns about z, with how many times each goes around.

        One that goes around is the wedge that spans the angles from 0 to 2 pi / sectors.
        """
        p = np.array(self.profile)
        angles = 2 * np.pi * np.arange(self.sectors) / self.sectors
        if self.thickness is None:
            return [
                (polytope(np.vstack([self._ring(a, angles), self._ring(b, angles)])), 1)
                for a, b in zip(p[:-1], p[1:], strict=True)
                if b[1] > a[1] and max(a[0], b[0]) > 0
            ]
        q = self.inner()
        floor = self.floor()
        if floor is not None:
            # A scaled copy differs in the last bits and must come to the same pieces: heights that
            # mean the floor's are made equal to it.
            for points in (p, q):
                points[np.abs(points[:, 1] - floor[1]) < self._rounding(), 1] = floor[1]
        quads = [np.array([p[i], p[i + 1], q[i + 1], q[i]]) for i in range(len(p) - 1)]
        pieces = []
        if floor is not None:
            # Below the inner floor all is solid: one stack of frusta, so that what stands on the
            # ground stands on one piece and not on every wedge.
            base = [*(c for c in p[1:] if c[1] < floor[1]), floor]
            pieces = [
                (polytope(np.vstack([self._ring(c, angles) for c in pair])), 1)
                for pair in zip(base[:-1], base[1:], strict=True)
            ]
            quads = [_above(quad, floor[1]) for quad in quads[1:]]
        for quad in quads:
            if len(quad) < 3:
                continue
            if quad[0][0] == 0 and len(quad) == 4 and quad[0][1] == quad[1][1]:
                disc = [self._ring(c, angles) for c in quad[1:3]]
                pieces.append((polytope(np.vstack(disc)), 1))
            else:
                wedge = [self._ring(c, angles[:2]) for c in quad]
                pieces.append((polytope(np.vstack(wedge)), self.sectors))
        return pieces

    def floor(self) -> NDArray | None:
        """Return the outer face's (r, z) at the height of a flat inner floor, None without one."""
        p = np.array(self.profile)
        if self.thickness is None or p[0, 0] > 0 or p[0, 1] != p[1, 1]:
            return None
        top = p[0, 1] + self.thickness
        over = np.flatnonzero(p[:, 1] >= top - self._rounding())
        if len(over) == 0 or np.any(np.diff(p[: over[0] + 1, 1]) < 0) or np.any(p[:, 1] < p[0, 1]):
            return None
        a, b = p[over[0] - 1], p[over[0]]
        share = min(1.0, (top - a[1]) / (b[1] - a[1]))
        return np.array([a[0] + share * (b[0] - a[0]), top])

    def _rounding(self) -> float:
        """Return a height [m] that is nothing beside the wall."""
        return 1e-6 * (self.thickness or 0.0)

    def _ring(self, corner: NDArray, angles: NDArray) -> NDArray:
        r, z = corner
        y = self.oval * r * np.sin(angles)
        return np.column_stack([r * np.cos(angles), y, np.full(len(angles), z)])


def _above(polygon: NDArray, z: float) -> NDArray:
    """Cut a convex (r, z) polygon off below a height."""
    found = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[1] >= z:
            found.append(a)
        if (a[1] - z) * (b[1] - z) < 0:
            found.append(a + (z - a[1]) / (b[1] - a[1]) * (b - a))
    kept = np.array(found).reshape(-1, 2)
    # What merely touches the cut, by rounding or in truth, is no piece.
    return kept if len(kept) >= 3 and np.ptp(kept[:, 1]) > 1e-9 * max(1.0, abs(z)) else kept[:0]


def _cross2(a: NDArray, b: NDArray) -> NDArray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


Shape = Annotated[
    Box
    | Sphere
    | Capsule
    | Cylinder
    | Ellipsoid
    | Prism
    | HollowBox
    | Lathe
    | Sweep
    | Extrusion
    | RoundedBox
    | CSG
    | Mesh,
    Field(discriminator="type"),
]

Placed.model_rebuild(_types_namespace={"Shape": Shape})
CSG.model_rebuild(_types_namespace={"Placed": Placed})

__all__ = [
    "CSG",
    "MAX_SECTORS",
    "MIN_SECTORS",
    "Box",
    "Capsule",
    "Cylinder",
    "Ellipsoid",
    "Extrusion",
    "Face",
    "HollowBox",
    "Lathe",
    "Length",
    "Mesh",
    "Number",
    "Placed",
    "Prism",
    "RoundedBox",
    "Shape",
    "Sphere",
    "Sweep",
]

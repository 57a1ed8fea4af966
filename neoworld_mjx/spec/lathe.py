"""Lathe: a profile revolved about z, either a solid or a shell with a wall of even thickness."""

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base import Length
from .convex import Piece, polytope
from .dimensions import UNSCALED
from .primitives import BaseShape, Point2, Sectors
from .triangles import SECTORS, hull_excess, revolved

FACETS = 64
"""Largest number of facets of a piece of joined bands."""


class Lathe(BaseShape):
    """A profile of (r, z) points revolved about z.

    With `thickness`, the profile is the outer face of a shell, such as a cup, a bowl or a saucer.
    The profile runs from the foot to the rim, and the wall lies to its left, that is, inwards and
    upwards. Without `thickness`, the profile bounds a solid, and z must not decrease.

    A solid, and the part of a shell below a flat inner floor, consist of frusta. Each band of a
    shell above the floor consists of wedges. The corners of these convex pieces lie on the true
    surface of revolution. Along a circle of radius r, pieces stay within
    e = r (1 - cos(pi / sectors)) of the surface. Neighboring bands are joined into one convex piece
    if its section exceeds those of the bands by at most e / 2 and by at most a quarter of the wall
    thickness.
    """

    type: Literal["lathe"] = "lathe"
    profile: tuple[Point2, ...] = Field(min_length=2, max_length=64)
    thickness: Length | None = None
    sectors: Sectors = 16
    oval: Annotated[float, Field(ge=0.05, le=20.0, allow_inf_nan=False), UNSCALED] = 1.0
    """Ratio of the size along y to the size along x. The shape, including the wall, is stretched
    along y."""

    @model_validator(mode="after")
    def _sane(self) -> "Lathe":
        p = np.array(self.profile)
        if (i := _first(p[:, 0] < 0)) is not None:
            raise ValueError(f"lathe radii must not be negative: profile[{i}] is {_shown(p[i])}")
        if (i := _first(np.all(np.diff(p, axis=0) == 0, axis=1))) is not None:
            raise ValueError(f"lathe profile[{i + 1}] repeats the point before it, {_shown(p[i])}")
        if self.thickness is None and (i := _first(np.diff(p[:, 1]) < 0)) is not None:
            raise ValueError(
                "the z of a solid lathe's profile must not decrease, as it does from "
                f"profile[{i}] {_shown(p[i])} to profile[{i + 1}] {_shown(p[i + 1])}"
            )
        if self.thickness is not None and (i := _first(p[1:, 0] == 0)) is not None:
            raise ValueError(
                "a lathe shell may touch the axis only at its first point, not at "
                f"profile[{i + 1}] {_shown(p[i + 1])}"
            )
        if not self.pieces():
            raise ValueError("lathe has no volume")
        return self

    def inner(self) -> NDArray:
        """Return the offset profile, the inner face of the shell, shape [len(profile), 2]."""
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

    def build_pieces(self) -> list[Piece]:
        """Return frusta for a solid, or wedges and bottom pieces for a shell."""
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
        """Return the pieces up to rotation about z, each with the number of times it is repeated.

        A repeated piece is the wedge that spans the angles from 0 to 2 pi / sectors.
        """
        p = np.array(self.profile)
        angles = 2 * np.pi * np.arange(self.sectors) / self.sectors
        if self.thickness is None:
            return self._frusta(p)
        q = self.inner()
        floor = self.floor()
        if floor is not None:
            # Set heights within rounding error of the floor to the floor, so that a scaled copy,
            # which differs in the last bits, has the same pieces.
            for points in (p, q):
                points[np.abs(points[:, 1] - floor[1]) < self._rounding(), 1] = floor[1]
        quads = [np.array([p[i], p[i + 1], q[i + 1], q[i]]) for i in range(len(p) - 1)]
        pieces = []
        if floor is not None:
            # Below the inner floor, use one stack of frusta, so that the shell stands on a single
            # piece instead of on every wedge.
            pieces = self._frusta(np.array([*(c for c in p[1:] if c[1] < floor[1]), floor]))
            quads = [_above(quad, floor[1]) for quad in quads[1:]]
        elif p[0, 0] == 0 and p[0, 1] == p[1, 1]:
            disc = [self._ring(c, angles) for c in quads[0][1:3]]
            pieces.append((polytope(np.vstack(disc)), 1))
            quads = quads[1:]
        for corners in self._joined([quad for quad in quads if len(quad) >= 3], (FACETS - 4) // 2):
            wedge = [self._ring(c, angles[:2]) for c in corners]
            pieces.append((polytope(np.vstack(wedge)), self.sectors))
        return pieces

    def _frusta(self, chain: NDArray) -> list[tuple[Piece, int]]:
        """Return the pieces of the solid inside a chain of (r, z) corners; z must not decrease."""
        angles = 2 * np.pi * np.arange(self.sectors) / self.sectors
        bands = [
            np.array([a, b, [0.0, b[1]], [0.0, a[1]]])
            for a, b in zip(chain[:-1], chain[1:], strict=True)
            if b[1] > a[1] and max(a[0], b[0]) > 0
        ]
        joined = self._joined(bands, (FACETS - 2) // self.sectors)
        stacks = [[self._ring(c, angles) for c in corners] for corners in joined]
        return [(polytope(np.vstack(stack)), 1) for stack in stacks]

    def _joined(self, bands: list[NDArray], limit: int) -> list[NDArray]:
        """Join runs of up to `limit` neighboring convex (r, z) polygons; return their corners."""
        runs: list[list[NDArray]] = []
        for band in bands:
            if runs:
                wider = np.vstack([*runs[-1], band])
                allowed = wider[:, 0].max() * (1 - np.cos(np.pi / self.sectors)) / 2
                allowed = min(allowed, (self.thickness or np.inf) / 4)
                if len(runs[-1]) < limit and hull_excess([*runs[-1], band]) <= allowed:
                    runs[-1].append(band)
                    continue
            runs.append([band])
        return [np.vstack(run) for run in runs]

    def floor(self) -> NDArray | None:
        """Return the outer face's (r, z) at the height of the flat inner floor, or None.

        Return None if there is no flat inner floor, or if the outer face does not rise steadily
        from the foot to the height of the floor.
        """
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
        """Return a height [m] that is negligible compared with the wall thickness."""
        return 1e-6 * (self.thickness or 0.0)

    def _ring(self, corner: NDArray, angles: NDArray) -> NDArray:
        r, z = corner
        y = self.oval * r * np.sin(angles)
        return np.column_stack([r * np.cos(angles), y, np.full(len(angles), z)])

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Revolve the section, with more sectors than the colliders have."""
        # Use a multiple of the colliders' sectors, so that corners of the colliders are corners of
        # the surface.
        sectors = self.sectors * math.ceil(SECTORS / self.sectors)
        vertices, faces = revolved(self.section(), sectors, closed=self.is_ring())
        return vertices * [1.0, self.oval, 1.0], faces

    def is_ring(self) -> bool:
        """Return whether the section is a closed loop that does not touch the axis."""
        return self.thickness is not None and self.profile[0][0] > 0

    def section(self) -> NDArray:
        """Return the chain of (r, z) corners that bounds the section [m], shape [n, 2].

        The chain begins and ends on the axis. For a ring, it is a closed loop.
        """
        profile = np.array(self.profile)
        if self.thickness is None:
            # Skip corners at equal heights that bound no volume.
            z = profile[:, 1]
            keep = [
                i
                for i in range(len(z))
                if not (
                    (z[i] == z[0] and i + 1 < len(z) and z[i + 1] == z[0])
                    or (z[i] == z[-1] and i > 0 and z[i - 1] == z[-1])
                    or (0 < i < len(z) - 1 and z[i - 1] == z[i] == z[i + 1])
                )
            ]
            p = profile[keep]
            foot = [[0.0, p[0, 1]]] if p[0, 0] > 0 else []
            head = [[0.0, p[-1, 1]]] if p[-1, 0] > 0 else []
            return np.array([*foot, *p.tolist(), *head])
        outer, floor = profile, self.floor()
        if floor is not None and np.linalg.norm(profile - floor, axis=1).min() > 1e-9:
            # Add the colliders' corners at the inner floor.
            outer = np.insert(profile, np.flatnonzero(profile[:, 1] >= floor[1])[0], floor, axis=0)
        return np.vstack([outer, self.inner()[::-1]])


def _above(polygon: NDArray, z: float) -> NDArray:
    """Return the part of a convex (r, z) polygon above a height."""
    points = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[1] >= z:
            points.append(a)
        if (a[1] - z) * (b[1] - z) < 0:
            points.append(a + (z - a[1]) / (b[1] - a[1]) * (b - a))
    above = np.array(points).reshape(-1, 2)
    # A polygon that merely touches the cut is empty.
    return above if len(above) >= 3 and np.ptp(above[:, 1]) > 1e-9 * max(1.0, abs(z)) else above[:0]


def _first(flags: NDArray) -> int | None:
    """Return the index of the first True, or None if all flags are False."""
    return int(np.argmax(flags)) if flags.any() else None


def _shown(point: NDArray) -> str:
    return f"({point[0]:g}, {point[1]:g})"

"""Sweep: a section swept along a path, such as a rod, handle, bail, hook, stem or ring."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base import Length, Point3
from .base_shape import BaseShape
from .convex import Piece, polytope
from .dimensions import UNSCALED
from .pose import from_axis_angle, rotate


class Sweep(BaseShape):
    """An elliptic section swept along straight segments with mitered joints.

    The section's `thickness` lies in the plane in which the path first bends, and its `width` is
    perpendicular to this plane. On a straight path, `width` is horizontal. Both are full diameters,
    given as one value for all points of the path or as one value for each point.

    Each segment is one convex piece, and neighboring pieces share the mitered face between them.
    The section is a polygon inside the ellipse, so pieces stay within d/2 (1 - cos(pi / sectors))
    of the ellipse, where d is its diameter.
    """

    type: Literal["sweep"] = "sweep"
    path: tuple[Point3, ...] = Field(min_length=2, max_length=64)
    width: tuple[Length, ...]
    thickness: tuple[Length, ...]
    closed: bool = False
    sectors: Annotated[int, Field(ge=4, le=32), UNSCALED] = 8

    @model_validator(mode="after")
    def _sane(self) -> "Sweep":
        for name, values in (("width", self.width), ("thickness", self.thickness)):
            if len(values) not in (1, len(self.path)):
                raise ValueError(
                    f"sweep {name} needs 1 value or {len(self.path)}, one for each point of the "
                    f"path, got {len(values)}"
                )
        path = np.array(self.path)
        if self.closed and len(path) < 3:
            raise ValueError("a closed sweep needs at least 3 points")
        steps = np.roll(path, -1, axis=0) - path if self.closed else np.diff(path, axis=0)
        length = np.linalg.norm(steps, axis=1)
        short = np.flatnonzero(length < 1e-6 * max(np.abs(path).max(), 1e-9))
        if len(short):
            i, j = int(short[0]), (int(short[0]) + 1) % len(path)
            raise ValueError(f"sweep path repeats a point: path[{i}] and path[{j}]")
        unit = steps / length[:, None]
        before = np.roll(unit, 1, axis=0) if self.closed else unit[:-1]
        after = unit if self.closed else unit[1:]
        cosine = np.sum(before * after, axis=1)
        if np.any(cosine < -0.5):
            k = int(np.argmin(cosine))
            degrees = np.degrees(np.arccos(np.clip(cosine[k], -1, 1)))
            index = k if self.closed else k + 1
            raise ValueError(
                f"sweep path turns by {degrees:.0f} degrees at path[{index}], "
                "at most 120 are allowed: insert a point"
            )
        rings, normals = self.rings(self.sectors)
        last = len(rings) if self.closed else len(rings) - 1
        for i in range(last):
            j = (i + 1) % len(rings)
            ahead = (rings[j] - path[i]) @ normals[i]
            behind = (rings[i] - path[j]) @ normals[j]
            if ahead.min() <= 0 or behind.max() >= 0:
                raise ValueError(
                    f"sweep bends too sharply for its thickness between points {i} and {j}"
                )
        return self

    def rings(self, sectors: int) -> tuple[NDArray, NDArray]:
        """Return the mitered section at each point of the path.

        Returns:
            The corners of the sections [m], shape [point, sectors, 3], and the normals of the
            sections' planes, shape [point, 3].
        """
        path = np.array(self.path)
        steps = np.roll(path, -1, axis=0) - path if self.closed else np.diff(path, axis=0)
        unit = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        count = len(path)
        into = [unit[i - 1] if i or self.closed else unit[0] for i in range(count)]
        out = [unit[i] if i < len(unit) else unit[-1] for i in range(count)]
        width = np.broadcast_to(np.array(self.width) / 2, count)
        thick = np.broadcast_to(np.array(self.thickness) / 2, count)
        angle = 2 * np.pi * (np.arange(sectors) + 0.5) / sectors
        side = _first_side(unit)
        rings, normals = [], []
        for i in range(count):
            t = into[i] if i else out[0]
            if i:
                side = _transported(side, out[i - 1] if i == 1 else into[i - 1], t)
            inward = np.cross(t, side)
            ring = np.outer(width[i] * np.cos(angle), side)
            ring = ring + np.outer(thick[i] * np.sin(angle), inward)
            normal = into[i] + out[i]
            normal = normal / np.linalg.norm(normal)
            ring = ring - np.outer(ring @ normal / (t @ normal), t)
            rings.append(path[i] + ring)
            normals.append(normal)
        return np.array(rings), np.array(normals)

    def build_pieces(self) -> list[Piece]:
        """Return one piece for each segment."""
        rings, _ = self.rings(self.sectors)
        last = len(rings) if self.closed else len(rings) - 1
        return [polytope(np.vstack([rings[i], rings[(i + 1) % len(rings)]])) for i in range(last)]

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Join sections with more corners than the colliders have, and close the ends."""
        sectors = self.sectors * -(-24 // self.sectors)
        rings, _ = self.rings(sectors)
        count = len(rings)
        index = np.arange(count * sectors).reshape(count, sectors)
        chain = np.vstack([index, index[:1]]) if self.closed else index
        faces = []
        for a, b in zip(chain[:-1], chain[1:], strict=True):
            a1, b1 = np.roll(a, -1), np.roll(b, -1)
            faces += [np.column_stack([a, a1, b]), np.column_stack([a1, b1, b])]
        if not self.closed:
            k = np.arange(1, sectors - 1)
            for ring, turned in ((index[0], True), (index[-1], False)):
                fan = np.column_stack([np.full_like(k, ring[0]), ring[k], ring[k + 1]])
                faces.append(fan[:, ::-1] if turned else fan)
        return rings.reshape(-1, 3), np.ascontiguousarray(np.vstack(faces))


def _first_side(unit: NDArray) -> NDArray:
    """Return the normal of the first bend's plane or, for a straight path, a horizontal normal."""
    for a, b in zip(unit[:-1], unit[1:], strict=True):
        k = np.cross(a, b)
        if np.linalg.norm(k) > 1e-6:
            k = k / np.linalg.norm(k)
            # Make the normal perpendicular to the first segment, which may precede the bend.
            k = k - (k @ unit[0]) * unit[0]
            if np.linalg.norm(k) > 1e-6:
                return k / np.linalg.norm(k)
    t = unit[0]
    k = np.cross([0.0, 0.0, 1.0], t)
    if np.linalg.norm(k) < 1e-6:
        k = np.array([0.0, 1.0, 0.0])
        k = k - (k @ t) * t
    return k / np.linalg.norm(k)


def _transported(side: NDArray, before: NDArray, after: NDArray) -> NDArray:
    """Rotate a direction with the path around a bend, without twist."""
    k = np.cross(before, after)
    size = np.linalg.norm(k)
    if size < 1e-12:
        return side
    rotated = rotate(from_axis_angle(k, float(np.arctan2(size, before @ after))), side)
    rotated = rotated - (rotated @ after) * after
    return rotated / np.linalg.norm(rotated)

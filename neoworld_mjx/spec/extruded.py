"""Extrusion of an arbitrary outline with holes, box with rounded edges, and sweep along a path.

A sweep is a section swept along a path, such as a rod, handle, bail, hook, stem or ring.
"""

from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base import Length, Point3
from .convex import Piece, hull, polytope, prism
from .dimensions import UNSCALED
from .pose import from_axis_angle, rotate
from .primitives import BaseShape, Point2
from .triangles import polygon_area

Loop = tuple[Point2, ...]


class Extrusion(BaseShape):
    """An outline of (x, y) points with holes, extruded along z from -height/2 to height/2.

    The outline need not be convex; examples are a bracket, a letter, and a panel with cut-outs. The
    pieces are convex prisms that tile the shape exactly.
    """

    type: Literal["extrusion"] = "extrusion"
    outline: Loop = Field(min_length=3, max_length=128)
    holes: tuple[Loop, ...] = Field(default=(), max_length=64)
    height: Length

    @model_validator(mode="after")
    def _simple(self) -> "Extrusion":
        loops = [np.array(loop) for loop in (self.outline, *self.holes)]
        if sum(len(loop) for loop in loops) > 512:
            raise ValueError("an extrusion may have at most 512 points in all")
        kinds = ("outline", *(f"holes[{k}]" for k in range(len(self.holes))))
        for loop, kind in zip(loops, kinds, strict=True):
            if len(loop) < 3 or abs(polygon_area(loop)) < 1e-12:
                raise ValueError(f"extrusion {kind} encloses no area")
        if (edges := crossing_edges(loops)) is not None:
            places = [
                f"{kind}[{i}]"
                for kind, loop in zip(kinds, loops, strict=True)
                for i in range(len(loop))
            ]
            first, second = (places[edge] for edge in edges)
            raise ValueError(
                "extrusion outline and holes must not cross or touch themselves, as the edges from "
                f"{first} and {second} do"
            )
        tiles = sum(abs(polygon_area(np.array(tile))) for tile in self.tiles())
        inside = abs(polygon_area(loops[0])) - sum(abs(polygon_area(loop)) for loop in loops[1:])
        if inside <= 0 or abs(tiles - inside) > 1e-6 * abs(polygon_area(loops[0])):
            raise ValueError("extrusion holes must lie inside the outline and apart")
        return self

    def tiles(self) -> tuple[Loop, ...]:
        """Return counterclockwise convex polygons that tile the outline without the holes."""
        return _tiles(self.outline, self.holes)

    def build_pieces(self) -> list[Piece]:
        """Return one prism for each convex tile."""
        return [prism(np.array(tile), self.height) for tile in self.tiles()]

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Triangulate both ends, and join them by the side faces."""
        loops = _wound(self.outline, self.holes)
        flat = np.vstack(loops)
        n, h = len(flat), self.height / 2
        vertices = np.vstack(
            [np.column_stack([flat, np.full(n, -h)]), np.column_stack([flat, np.full(n, h)])]
        )
        caps = _triangles(loops)
        faces, start = [caps[:, ::-1], caps + n], 0
        for loop in loops:
            i = start + np.arange(len(loop))
            j = start + (np.arange(len(loop)) + 1) % len(loop)
            faces += [np.column_stack([i, j, n + j]), np.column_stack([i, n + j, n + i])]
            start += len(loop)
        return vertices, np.ascontiguousarray(np.vstack(faces).astype(np.int64))


class RoundedBox(BaseShape):
    """A centered box with rounded edges and corners; `size` holds full edge lengths."""

    type: Literal["rounded_box"] = "rounded_box"
    size: tuple[Length, Length, Length]
    radius: Length

    @model_validator(mode="after")
    def _fits(self) -> "RoundedBox":
        if 2 * self.radius >= min(self.size):
            raise ValueError(f"radius {self.radius} is too large for a box of size {self.size}")
        return self

    def build_pieces(self) -> list[Piece]:
        """Return one convex piece, whose corners lie on the rounded surface."""
        return [polytope(self._points(2))]

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Return the convex hull of a finer set of points than that of the collider."""
        return hull(tuple(map(tuple, np.unique(self._points(6), axis=0).tolist())))

    def _points(self, steps: int) -> NDArray:
        angle = np.linspace(0, np.pi / 2, steps + 1)
        # Sines are reversed cosines, so that opposite corners match exactly.
        c = np.cos(angle)
        c[-1] = 0.0
        s = c[::-1]
        ball = np.array(
            [[c[i] * c[k], c[i] * s[k], s[i]] for i in range(steps + 1) for k in range(steps + 1)]
        )
        inner = np.array(self.size) / 2 - self.radius
        corner = inner + self.radius * ball
        signs = np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T
        return np.vstack([corner * sign for sign in signs])


@lru_cache(maxsize=512)
def _tiles(outline: Loop, holes: tuple[Loop, ...]) -> tuple[Loop, ...]:
    """Merge triangles into convex polygons (Hertel and Mehlhorn, 1983)."""
    loops = _wound(outline, holes)
    flat = np.vstack(loops)
    polygons = [list(map(int, t)) for t in _triangles(loops)]
    # Edges whose two polygons cannot be merged unless one of the two polygons changes.
    refused: set[tuple[int, int]] = set()
    merged = True
    while merged:
        merged = False
        edges = {
            (p[i], p[(i + 1) % len(p)]): k for k, p in enumerate(polygons) for i in range(len(p))
        }
        for (a, b), k in edges.items():
            other = edges.get((b, a))
            if other is None or other == k or (a, b) in refused:
                continue
            union = _joined(polygons[k], polygons[other], a, b)
            if not _convex(flat[union]):
                refused |= {(a, b), (b, a)}
            else:
                around = list(zip(union, union[1:] + union[:1], strict=True))
                refused -= {*around, *((j, i) for i, j in around)}
                polygons[k] = union
                del polygons[other]
                merged = True
                break
    return tuple(tuple(map(tuple, flat[p].tolist())) for p in polygons)


def _joined(one: list[int], two: list[int], a: int, b: int) -> list[int]:
    i, j = one.index(a), two.index(a)
    # `one` runs ... a b ..., `two` runs ... b a ...: leave the common edge out of both.
    head = one[i + 1 :] + one[: i + 1]
    tail = two[j + 1 :] + two[:j]
    return head + [v for v in tail if v != b]


def _convex(p: NDArray) -> bool:
    e = np.roll(p, -1, axis=0) - p
    f = np.roll(e, -1, axis=0)
    turn = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    return bool(np.all(turn >= -1e-12 * np.abs(e).max() ** 2))


def _triangles(loops: list[NDArray]) -> NDArray:
    """Triangulate an outline with holes; return point indices [f, 3], counted over all loops."""
    import manifold3d

    return np.asarray(manifold3d.triangulate(loops))


def _wound(outline: Loop, holes: tuple[Loop, ...]) -> list[NDArray]:
    """Return the outline counterclockwise, and the holes clockwise, as arrays [n, 2]."""
    wound = []
    for k, loop in enumerate((outline, *holes)):
        p = np.array(loop, float)
        wound.append(p[::-1].copy() if (polygon_area(p) < 0) == (k == 0) else p)
    return wound


def crossing_edges(loops: list[NDArray]) -> tuple[int, int] | None:
    """Return the indices of two edges that cross or touch, or None if there are none.

    Neighboring edges may touch at their common corner. The index of an edge is the index of its
    first point, counted over all loops.
    """
    import shapely

    starts = np.vstack(loops)
    ends = np.vstack([np.roll(loop, -1, axis=0) for loop in loops])
    numbers = np.split(np.arange(len(starts)), np.cumsum([len(loop) for loop in loops])[:-1])
    following = np.concatenate([np.roll(loop, -1) for loop in numbers])
    edges = np.asarray(shapely.linestrings(np.stack([starts, ends], axis=1)))
    one, other = shapely.STRtree(edges).query(edges, predicate="intersects")
    apart = (one < other) & (following[one] != other) & (following[other] != one)
    return min(zip(one[apart].tolist(), other[apart].tolist(), strict=True), default=None)


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

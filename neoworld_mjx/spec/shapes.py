"""The union type of all shapes, imported meshes, and shapes that combine other shapes (CSG).

The convex pieces of a shape do not overlap, so volume and inertia are sums over the pieces. The
pieces are also the colliders, so cavities stay open. Lengths are in meters; each class states its
frame. To add a shape, define a subclass of `BaseShape` in a module and add the class to `Shape`.

Constructive solid geometry gives an exact convex decomposition. The convex pieces of an operand are
cut by manifold3d along the planes of the other operands' faces, so colliders leave the material
that a difference removes empty. Round operands become polyhedra with `sectors` facets, whose
corners lie on the true surface. Along a circle of radius r, colliders stay within
r (1 - cos(pi / sectors)) of the surface. The visual surface has finer facets.
"""

import itertools
from functools import lru_cache
from typing import Annotated, Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, model_validator

from .base import Length, Point3, Rotation, ScalableSpec
from .convex import Kind, Piece, planes, polytope
from .dimensions import UNSCALED
from .extruded import Extrusion, RoundedBox, Sweep
from .lathe import Lathe
from .pose import IDENTITY, Pose, pose
from .primitives import (
    BaseShape,
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    HollowBox,
    Prism,
    Sectors,
    Sphere,
)
from .triangles import SECTORS

MAX_VERTICES, MAX_HULLS = 200_000, 512
UNKNOWN, HELPER = "unknown", "helper"
"""Prefixes of material names of imported objects. UNKNOWN marks a material whose density the file
does not state; HELPER marks the material of the small sphere that replaces a link without geometry.
"""


class Mesh(BaseShape):
    """Visible triangles, and convex hulls that collide and determine the mass.

    If there are no hulls, the collider is the convex hull of all vertices. The surface need not be
    closed.
    """

    type: Literal["mesh"] = "mesh"
    vertices: tuple[Point3, ...] = Field(min_length=4, max_length=MAX_VERTICES)
    faces: Annotated[tuple[tuple[int, int, int], ...], UNSCALED] = Field(
        min_length=1, max_length=2 * MAX_VERTICES
    )
    hulls: tuple[tuple[Point3, ...], ...] = Field(default=(), max_length=MAX_HULLS)

    @model_validator(mode="after")
    def _whole(self) -> "Mesh":
        corners = np.array(self.faces)
        if corners.min() < 0 or corners.max() >= len(self.vertices):
            raise ValueError("mesh faces refer to vertices that do not exist")
        self.pieces()
        return self

    def build_pieces(self) -> list[Piece]:
        """Return the hulls."""
        return [polytope(np.array(points)) for points in self.hulls or (self.vertices,)]

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Return the triangles unchanged."""
        return np.array(self.vertices), np.array(self.faces, np.int64)


Operation = Literal["union", "difference", "intersection"]
MAX_PIECES, MAX_CUTS, MAX_OPERAND_TRIANGLES, MAX_BODIES = 600, 4000, 60_000, 64
BOX_TEST_COST = 0.02
"""Cost of comparing two bounding boxes, relative to the cost of a cut."""
SLACK = 1e-6
"""Smallest thickness of a piece, relative to the size of the operands."""
LEAST_VOLUME = 1e-9
"""Smallest volume of a piece, relative to the cube of the size of the operands."""


@runtime_checkable
class PlacedShape(Protocol):
    """A shape with its pose. It must be hashable, because results are cached."""

    @property
    def shape(self) -> Any:
        """The shape, a `BaseShape`."""
        ...

    def pose(self) -> Pose:
        """Return the pose of the shape in the frame of the result."""
        ...


class _Convex(NamedTuple):
    """A convex solid."""

    solid: Any
    """The solid, a `manifold3d.Manifold`."""
    corners: NDArray
    """Vertices [m], shape [v, 3]."""

    def disjoint(self, other: "_Convex", slack: float) -> bool:
        """Return True if the bounding boxes of two solids overlap by at most `slack` [m]."""
        a, b = self.corners, other.corners
        apart = a.min(axis=0) > b.max(axis=0) - slack
        return bool(np.any(apart | (b.min(axis=0) > a.max(axis=0) - slack)))


_Tool = tuple[_Convex, NDArray]
"""A convex solid and its half-spaces [f, 4]."""


class _Cutter:
    """Cuts convex solids, limits the number of cuts, and drops parts of negligible volume."""

    def __init__(self, size: float) -> None:
        self.slack, self.negligible = SLACK * size, LEAST_VOLUME * size**3
        self.cuts_left = float(MAX_CUTS)

    def subtract(self, solids: list[_Convex], tool: _Tool) -> list[_Convex]:
        """Return the parts of convex solids that lie outside a convex tool."""
        body, half = tool
        result: list[_Convex] = []
        for piece in solids:
            if self._disjoint(piece, body):
                result.append(piece)
                continue
            remainder, outside = self._cut(piece, half)
            # A solid that barely overlaps the tool stays whole.
            parts = [piece] if remainder is None or self._is_negligible(remainder) else outside
            result += [part for part in parts if not self._is_negligible(part)]
            _check_count(result)
        return result

    def common(self, solids: list[_Convex], tools: list[_Tool]) -> list[_Convex]:
        """Return the intersections of convex solids with convex tools that do not overlap."""
        result: list[_Convex] = []
        for piece in solids:
            for body, half in tools:
                if self._disjoint(piece, body):
                    continue
                remainder, _ = self._cut(piece, half)
                if remainder is not None and not self._is_negligible(remainder):
                    result.append(remainder)
            _check_count(result)
        return result

    def _cut(self, piece: _Convex, half: NDArray) -> tuple[_Convex | None, list[_Convex]]:
        """Return the part of a solid inside all half-spaces, and the parts outside.

        No part is thinner than `slack`.
        """
        inside: _Convex | None = piece
        outside: list[_Convex] = []
        for *normal, offset in half:
            if inside is None:
                break
            self._spend(1 + inside.solid.num_tri() / 64)
            height = inside.corners @ normal - offset
            if height.min() >= -self.slack:
                outside.append(inside)
                inside = None
            elif height.max() > self.slack:
                beyond, within = map(_convex, inside.solid.split_by_plane(normal, offset))
                outside.append(beyond)
                inside = within
        return inside, outside

    def _disjoint(self, a: _Convex, b: _Convex) -> bool:
        self._spend(BOX_TEST_COST)
        return a.disjoint(b, self.slack)

    def _spend(self, cost: float) -> None:
        self.cuts_left -= cost
        if self.cuts_left < 0:
            raise ValueError(_TOO_MANY)

    def _is_negligible(self, piece: _Convex) -> bool:
        return piece.solid.volume() < self.negligible


_TOO_MANY = (
    f"csg needs more than {MAX_PIECES} convex pieces, or more than {MAX_CUTS} cuts: use fewer "
    f"operands or fewer sectors"
)


def _check_count(pieces: list[Any]) -> None:
    if len(pieces) > MAX_PIECES:
        raise ValueError(_TOO_MANY)


def _convex(solid: Any) -> _Convex:
    return _Convex(solid, np.array(solid.to_mesh64().vert_properties, float)[:, :3])


def _tool(piece: Piece, pose: Pose) -> _Tool:
    """Return a piece of kind "box" or "mesh" at its total pose, with its half-spaces."""
    import manifold3d

    half = planes(piece)
    corners = pose.apply(faceted(piece))
    normals = pose.apply(half[:, :3]) - pose.pos
    offsets = (corners @ normals.T).max(axis=0)
    solid = manifold3d.Manifold.hull_points(corners)
    return _Convex(solid, corners), np.column_stack([normals, offsets])


@lru_cache(maxsize=256)
def decomposed(
    operation: Operation, operands: tuple[PlacedShape, ...], sectors: int
) -> tuple[Piece, ...]:
    """Return the convex pieces of a boolean combination of shapes; the pieces do not overlap.

    Raises:
        ValueError: the result needs more than MAX_PIECES pieces or more than MAX_CUTS cuts.
    """
    tools: list[list[_Tool]] = []
    for operand in operands:
        tools.append(convex_operands(operand, sectors))
        if sum(len(half) for group in tools for _, half in group) > MAX_CUTS:
            raise ValueError(_TOO_MANY)
    points = np.vstack([body.corners for group in tools for body, _ in group])
    cutter = _Cutter(float(np.ptp(points, axis=0).max()))
    result = [body for body, _ in tools[0]]
    for group in tools[1:]:
        if operation == "intersection":
            result = cutter.common(result, group)
            continue
        if operation == "union":
            # Add only the part of this operand that lies outside the earlier ones, so that pieces
            # never overlap.
            added = [body for body, _ in group]
            for body in result:
                added = cutter.subtract(added, (body, planes(polytope(body.corners))))
            result = [*result, *added]
        else:
            for tool in group:
                result = cutter.subtract(result, tool)
        _check_count(result)
    return tuple(polytope(one.corners) for one in result)


def convex_operands(operand: PlacedShape, sectors: int) -> list[_Tool]:
    """Return an operand's convex pieces as polyhedra, each with its half-spaces [f, 4]."""
    pieces = operand.shape.pieces()
    _check_count(pieces)
    tools = []
    for piece in pieces:
        flat = piece
        if piece.kind not in ("box", "mesh"):
            flat = _faceted_piece(piece.kind, piece.size, sectors)
        tools.append(_tool(flat, operand.pose().then(pose(piece.pos, piece.quat))))
    return tools


@lru_cache(maxsize=64)
def _faceted_piece(kind: Kind, size: tuple[float, ...], sectors: int) -> Piece:
    """Return a round piece as a polyhedron."""
    return polytope(faceted(Piece(kind, size), sectors))


def faceted(piece: Piece, sectors: int = SECTORS) -> NDArray:
    """Return the corners of a piece, or points on a round one, in its frame [m], shape [n, 3]."""
    if piece.kind == "mesh":
        return np.array(piece.vertices)
    if piece.kind == "box":
        return np.array(list(itertools.product((-1, 1), repeat=3))) * np.array(piece.size)
    angle = 2 * np.pi * np.arange(sectors) / sectors
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(sectors)])
    if piece.kind == "cylinder":
        r, h = piece.size[:2]
        return np.vstack([ring * r + [0, 0, h], ring * r - [0, 0, h]])
    rings = max(2, sectors // 4) * 2
    tilt = np.pi * np.arange(1, rings) / rings - np.pi / 2
    ball = np.vstack([ring * np.cos(t) + [0, 0, np.sin(t)] for t in tilt])
    ball = np.vstack([ball, [[0, 0, 1], [0, 0, -1]]])
    if piece.kind == "capsule":
        r, h = piece.size[:2]
        ends = [ball[ball[:, 2] > -1e-12] * r + [0, 0, h], ball[ball[:, 2] < 1e-12] * r - [0, 0, h]]
        return np.vstack(ends)
    radii = np.full(3, piece.size[0]) if piece.kind == "sphere" else np.array(piece.size)
    return ball * radii


@lru_cache(maxsize=256)
def boolean_surface(
    operation: Operation, operands: tuple[PlacedShape, ...]
) -> tuple[NDArray, NDArray]:
    """Return the vertices [m], shape [v, 3], and triangles [f, 3] that manifold3d computes."""
    mesh = _manifold(operation, operands).to_mesh64()
    vertices = np.array(mesh.vert_properties, float)[:, :3]
    return vertices, np.array(mesh.tri_verts, np.int64)


@lru_cache(maxsize=256)
def count_bodies(operation: Operation, operands: tuple[PlacedShape, ...]) -> int:
    """Return the number of connected components of a boolean combination of shapes."""
    # manifold3d also returns closed cavities, as bodies of negative volume.
    bodies = _manifold(operation, operands).decompose()
    if len(bodies) < 2:
        return len(bodies)
    whole = sum(abs(body.volume()) for body in bodies)
    solid = [body for body in bodies if body.volume() > 1e-7 * whole]
    if len(solid) > MAX_BODIES:
        return len(solid)
    # Rounding may leave gaps between faces that should touch.
    near = SLACK * whole ** (1 / 3)
    group = list(range(len(solid)))
    for i, k in itertools.combinations(group, 2):
        if group[i] != group[k] and solid[i].min_gap(solid[k], 2 * near) < near:
            group = [group[i] if g == group[k] else g for g in group]
    return len(set(group))


def _manifold(operation: Operation, operands: tuple[PlacedShape, ...]) -> Any:
    import manifold3d

    kinds = manifold3d.OpType
    kind = {"union": kinds.Add, "difference": kinds.Subtract, "intersection": kinds.Intersect}
    solids, count = [], 0
    for operand in operands:
        vertices, faces = operand.shape.surface()
        count += len(faces)
        if count > MAX_OPERAND_TRIANGLES:
            raise ValueError(f"csg operands have over {MAX_OPERAND_TRIANGLES} triangles: use fewer")
        mesh = manifold3d.Mesh64(
            np.ascontiguousarray(operand.pose().apply(vertices)), faces.astype(np.uint64)
        )
        solids.append(manifold3d.Manifold(mesh))
        if solids[-1].status() != manifold3d.Error.NoError:
            raise ValueError(f"csg cannot take a {operand.shape.type}: {solids[-1].status()}")
    return manifold3d.Manifold.batch_boolean(solids, kind[operation])


MAX_DEPTH = 6
"""Largest nesting depth of CSG shapes."""


class Operand(ScalableSpec):
    """A shape with its pose."""

    shape: "Shape"
    pos: Point3 = (0.0, 0.0, 0.0)
    quat: Rotation = IDENTITY

    def pose(self) -> Pose:
        """Return the operand's pose in the frame of the CSG shape."""
        return pose(self.pos, self.quat)


class CSG(BaseShape):
    """A boolean combination of solids: union, difference (first minus others) or intersection.

    The operands do not change with scale; `factor` scales the result. A scaled copy therefore has
    the same decomposition.
    """

    type: Literal["csg"] = "csg"
    operation: Operation
    operands: Annotated[tuple[Operand, ...], UNSCALED] = Field(min_length=2, max_length=64)
    sectors: Sectors = 16
    factor: Length = 1.0

    @model_validator(mode="after")
    def _solid(self) -> "CSG":
        if _depth(self) > MAX_DEPTH:
            raise ValueError(f"csg shapes may be nested at most {MAX_DEPTH} deep")
        if not decomposed(self.operation, self.operands, self.sectors):
            raise ValueError(f"csg {self.operation} leaves nothing")
        bodies = count_bodies(self.operation, self.operands)
        if bodies > 1:
            raise ValueError(
                f"csg {self.operation} consists of {bodies} separate solids; make each a separate "
                f"shape"
            )
        return self

    def build_pieces(self) -> list[Piece]:
        """Return the pieces of the decomposition."""
        pieces = decomposed(self.operation, self.operands, self.sectors)
        f = self.factor
        if f == 1.0:
            return list(pieces)
        return [
            Piece("mesh", vertices=tuple((x * f, y * f, z * f) for x, y, z in piece.vertices))
            for piece in pieces
        ]

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Return the surface that manifold3d computes."""
        vertices, faces = boolean_surface(self.operation, self.operands)
        return vertices * self.factor, np.array(faces)


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

Operand.model_rebuild(_types_namespace={"Shape": Shape})
CSG.model_rebuild(_types_namespace={"Operand": Operand})


def _depth(shape: BaseModel) -> int:
    if not isinstance(shape, CSG):
        return 0
    return 1 + max(_depth(operand.shape) for operand in shape.operands)

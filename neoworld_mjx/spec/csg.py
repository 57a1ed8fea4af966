"""Constructive solid geometry: union, difference and intersection of shapes.

Colliders are an exact convex decomposition, made by cutting convex pieces along the planes of the
others; so what a difference takes away is really open. Round operands count as polyhedra with
`sectors` facets, whose corners lie on the true surface: colliders stay within
r (1 - cos(pi / sectors)) of it. The visual surface comes from manifold3d,
with finer facets.
"""

import itertools
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, field_validator, model_validator

from .base import Length, Point3, Quat, Rotation, ScalableSpec, unit_vector
from .base_shape import BaseShape, Sectors
from .clip import Poly, poly, split
from .convex import Kind, Piece, polytope
from .dimensions import UNSCALED
from .pose import IDENTITY, Pose, pose

if TYPE_CHECKING:
    from .shapes import Shape

Operation = Literal["union", "difference", "intersection"]
MAX_PIECES, MAX_CUTS, MAX_DEPTH, MAX_TRIANGLES = 600, 4000, 6, 60_000
MAX_BODIES = 64
BOX_TEST_COST = 0.02
"""Cost of comparing two bounding boxes, over that of a cut."""
SLACK = 1e-6
"""Thickness over the size of the operands below which a piece does not count."""
NEGLIGIBLE = 1e-9
"""Volume over the cube of that size below which a piece is left out."""


class Operand(ScalableSpec):
    """A shape in its place."""

    shape: "Shape"
    pos: Point3 = (0.0, 0.0, 0.0)
    quat: Rotation = IDENTITY

    @field_validator("quat")
    @classmethod
    def _unit(cls, value: Quat) -> Quat:
        return unit_vector(value, "quat")

    def pose(self) -> Pose:
        """Return the operand's pose in the frame of the whole."""
        return pose(self.pos, self.quat)


class CSG(BaseShape):
    """A solid made of others: all of them, the first without the rest, or what all share.

    Operands are written at size 1; `factor` scales the whole, so that a scaled copy is cut up in
    the very same way.
    """

    type: Literal["csg"] = "csg"
    operation: Operation
    operands: Annotated[tuple[Operand, ...], UNSCALED] = Field(min_length=2, max_length=64)
    sectors: Sectors = 16
    factor: Length = 1.0

    @model_validator(mode="after")
    def _solid(self) -> "CSG":
        if _depth(self) > MAX_DEPTH:
            raise ValueError(f"csg shapes may lie at most {MAX_DEPTH} deep in each other")
        if not _cut(self.operation, self.operands, self.sectors):
            raise ValueError(f"csg {self.operation} leaves nothing")
        apart = _bodies(self.operation, self.operands)
        if apart > 1:
            raise ValueError(
                f"csg {self.operation} falls into {apart} solids that do not hang together; make "
                f"each a shape of its own"
            )
        return self

    def build_pieces(self) -> list[Piece]:
        """Return the pieces of the decomposition."""
        pieces = _cut(self.operation, self.operands, self.sectors)
        if self.factor == 1.0:
            return list(pieces)
        return [
            Piece(
                "mesh",
                vertices=tuple(
                    (x * self.factor, y * self.factor, z * self.factor) for x, y, z in p.vertices
                ),
            )
            for p in pieces
        ]

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Take the surface of manifold3d's boolean."""
        vertices, faces = _skin(self.operation, self.operands)
        return vertices * self.factor, faces.copy()


class _Convex(NamedTuple):
    """A convex operand, or what is left of it."""

    solid: Poly
    low: NDArray
    high: NDArray


class _Cutter:
    """Cuts convex solids; counts the cuts and drops negligible remains."""

    def __init__(self, size: float) -> None:
        self.slack, self.negligible = SLACK * size, NEGLIGIBLE * size**3
        self.cuts_left = float(MAX_CUTS)

    def subtract(self, solids: list[_Convex], tool: tuple[_Convex, NDArray]) -> list[_Convex]:
        """Return the parts of convex solids that lie outside a convex one."""
        body, half = tool
        kept: list[_Convex] = []
        for one in solids:
            if self._apart(one, body):
                kept.append(one)
                continue
            rest: Poly | None = one.solid
            outside: list[Poly] = []
            for plane in half:
                rest, beyond = self._split(rest, plane)
                if beyond is not None:
                    outside.append(beyond)
                if rest is None:
                    break
            # What only came near stays whole.
            left = [one.solid] if rest is None or self._is_negligible(rest) else outside
            kept += [_convex(p) for p in left if not self._is_negligible(p)]
            if len(kept) > MAX_PIECES:
                raise ValueError(_TOO_MANY)
        return kept

    def common(self, solids: list[_Convex], tools: list[tuple[_Convex, NDArray]]) -> list[_Convex]:
        """Return what convex solids share with any of several convex ones that do not overlap."""
        kept: list[_Convex] = []
        for one in solids:
            for body, half in tools:
                if self._apart(one, body):
                    continue
                rest: Poly | None = one.solid
                for plane in half:
                    rest, _ = self._split(rest, plane)
                    if rest is None:
                        break
                if rest is not None and not self._is_negligible(rest):
                    kept.append(_convex(rest))
            if len(kept) > MAX_PIECES:
                raise ValueError(_TOO_MANY)
        return kept

    def _split(self, solid: Poly | None, plane: NDArray) -> tuple[Poly | None, Poly | None]:
        if solid is None:
            return None, None
        self.cuts_left -= 1 + len(solid.faces) / 32
        if self.cuts_left < 0:
            raise ValueError(_TOO_MANY)
        return split(solid, plane, self.slack)

    def _apart(self, one: _Convex, other: _Convex) -> bool:
        self.cuts_left -= BOX_TEST_COST
        if self.cuts_left < 0:
            raise ValueError(_TOO_MANY)
        return bool(
            np.any(one.low > other.high - self.slack) or np.any(other.low > one.high - self.slack)
        )

    def _is_negligible(self, solid: Poly) -> bool:
        return len(solid.corners) < 4 or solid.volume() < self.negligible


_TOO_MANY = (
    f"csg would fall into over {MAX_PIECES} convex pieces, or take over {MAX_CUTS} cuts: use fewer "
    f"operands, or fewer sectors"
)


def _convex(solid: Poly) -> _Convex:
    return _Convex(solid, solid.corners.min(axis=0), solid.corners.max(axis=0))


@lru_cache(maxsize=256)
def _cut(operation: Operation, operands: tuple[Operand, ...], sectors: int) -> tuple[Piece, ...]:
    tools: list[list[tuple[_Convex, NDArray]]] = []
    for operand in operands:
        tools.append(_tools(operand, sectors))
        # Whatever is cut, every face of every tool is looked at.
        if sum(len(half) for group in tools for _, half in group) > MAX_CUTS:
            raise ValueError(_TOO_MANY)
    points = np.vstack([body.solid.corners for group in tools for body, _ in group])
    cutter = _Cutter(float(np.ptp(points, axis=0).max()))
    result = [body for body, _ in tools[0]]
    for group in tools[1:]:
        if operation == "intersection":
            result = cutter.common(result, group)
            continue
        fresh = [body for body, _ in group]
        if operation == "union":
            # The later ones keep what the earlier ones have not: pieces never overlap.
            taken = [(body, _half_spaces(body)) for body in result]
            for tool in taken:
                fresh = cutter.subtract(fresh, tool)
            result = [*result, *fresh]
        else:
            for tool in group:
                result = cutter.subtract(result, tool)
        if len(result) > MAX_PIECES:
            raise ValueError(_TOO_MANY)
    return tuple(polytope(one.solid.corners) for one in result)


def _half_spaces(body: _Convex) -> NDArray:
    return poly(polytope(body.solid.corners), pose())[1]


def _tools(operand: Operand, sectors: int) -> list[tuple[_Convex, NDArray]]:
    at = operand.pose()
    pieces = operand.shape.pieces()
    if len(pieces) > MAX_PIECES:
        raise ValueError(_TOO_MANY)
    tools = []
    for piece in pieces:
        flat = piece if piece.kind in ("box", "mesh") else _flat(piece.kind, piece.size, sectors)
        solid, half = poly(flat, at.then(pose(piece.pos, piece.quat)))
        tools.append((_convex(solid), half))
    return tools


@lru_cache(maxsize=64)
def _flat(kind: Kind, size: tuple[float, ...], sectors: int) -> Piece:
    """Return a round piece as a polyhedron."""
    return polytope(faceted(Piece(kind, size), sectors))


def faceted(piece: Piece, sectors: int) -> NDArray:
    """Return corners on the surface of a round piece, in its own frame."""
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
def _skin(operation: Operation, operands: tuple[Operand, ...]) -> tuple[NDArray, NDArray]:
    mesh = _manifold(operation, operands).to_mesh64()
    vertices = np.array(mesh.vert_properties, float)[:, :3]
    return vertices, np.array(mesh.tri_verts, np.int64)


@lru_cache(maxsize=256)
def _bodies(operation: Operation, operands: tuple[Operand, ...]) -> int:
    # A closed hole inside is a body of negative volume.
    bodies = _manifold(operation, operands).decompose()
    if len(bodies) < 2:
        return len(bodies)
    whole = sum(abs(body.volume()) for body in bodies)
    solid = [body for body in bodies if body.volume() > 1e-7 * whole]
    if len(solid) > MAX_BODIES:
        return len(solid)
    # Faces that should touch may miss each other by rounding.
    near = SLACK * whole ** (1 / 3)
    group = list(range(len(solid)))
    for i, k in itertools.combinations(group, 2):
        if group[i] != group[k] and solid[i].min_gap(solid[k], 2 * near) < near:
            group = [group[i] if g == group[k] else g for g in group]
    return len(set(group))


def _manifold(operation: Operation, operands: tuple[Operand, ...]) -> Any:
    import manifold3d

    kinds = manifold3d.OpType
    kind = {"union": kinds.Add, "difference": kinds.Subtract, "intersection": kinds.Intersect}
    solids, count = [], 0
    for operand in operands:
        vertices, faces = operand.shape.surface()
        count += len(faces)
        if count > MAX_TRIANGLES:
            raise ValueError(f"csg operands have over {MAX_TRIANGLES} triangles: use fewer")
        mesh = manifold3d.Mesh64(
            np.ascontiguousarray(operand.pose().apply(vertices)), faces.astype(np.uint64)
        )
        solids.append(manifold3d.Manifold(mesh))
        if solids[-1].status() != manifold3d.Error.NoError:
            raise ValueError(f"csg cannot take a {operand.shape.type}: {solids[-1].status()}")
    return manifold3d.Manifold.batch_boolean(solids, kind[operation])


def _depth(shape: BaseModel) -> int:
    if not isinstance(shape, CSG):
        return 0
    return 1 + max(_depth(operand.shape) for operand in shape.operands)

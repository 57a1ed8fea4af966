"""The union type of all shapes, and the shape that combines other shapes.

The convex pieces of a shape do not overlap, so volume and inertia are sums over the pieces. The
pieces are also the colliders, so cavities stay open. Lengths are in meters; each class states its
frame. To add a shape, define a subclass of `BaseShape` in a module and add the class to `Shape`.
"""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, field_validator, model_validator

from .base import Length, Point3, Quat, Rotation, ScalableSpec, unit_vector
from .base_shape import BaseShape, Sectors
from .convex import Piece
from .csg import Operation, boolean_surface, count_bodies, decomposed
from .dimensions import UNSCALED
from .extruded import Extrusion, RoundedBox
from .lathe import Lathe
from .mesh import Mesh
from .pose import IDENTITY, Pose, pose
from .primitives import Box, Capsule, Cylinder, Ellipsoid, HollowBox, Prism, Sphere
from .swept import Sweep

MAX_DEPTH = 6
"""Largest nesting depth of CSG shapes."""


class Operand(ScalableSpec):
    """A shape with its pose."""

    shape: "Shape"
    pos: Point3 = (0.0, 0.0, 0.0)
    quat: Rotation = IDENTITY

    @field_validator("quat")
    @classmethod
    def _unit(cls, value: Quat) -> Quat:
        return unit_vector(value, "quat")

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

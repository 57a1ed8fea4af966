"""The shapes that parts are made of, each parametric and the sum of its convex pieces.

A shape's pieces do not overlap, so volume and inertia are sums over them, and they are the
colliders as well: cavities stay open. Lengths are in metres; each class states its frame. A new
shape is a class of `BaseShape` in a file of its own and an entry in `Shape`.
"""

from typing import Annotated

from pydantic import Field

from .csg import CSG, Operand
from .extruded import Extrusion, RoundedBox
from .lathe import Lathe
from .mesh import Mesh
from .primitives import Box, Capsule, Cylinder, Ellipsoid, HollowBox, Prism, Sphere
from .swept import Sweep

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

__all__ = [
    "CSG",
    "Box",
    "Capsule",
    "Cylinder",
    "Ellipsoid",
    "Extrusion",
    "HollowBox",
    "Lathe",
    "Mesh",
    "Operand",
    "Prism",
    "RoundedBox",
    "Shape",
    "Sphere",
    "Sweep",
]

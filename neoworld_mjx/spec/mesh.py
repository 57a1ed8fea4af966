"""A triangle mesh from an imported file, with its convex pieces."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base import Point3
from .base_shape import BaseShape
from .convex import Piece, polytope
from .dimensions import UNSCALED

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

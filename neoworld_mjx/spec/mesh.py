"""A shape given by triangles, as files from elsewhere bring it, with its convex pieces."""

from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base_shape import BaseShape, Point3
from .convex import Piece, polytope

MAX_VERTICES, MAX_HULLS = 200_000, 512
UNKNOWN, HELPER = "unknown", "helper"
"""How the materials of imported things begin: those whose density was not stated, and those of beads
that stand for links without geometry."""


class Mesh(BaseShape):
    """Triangles that are seen, and the convex hulls that collide and have the mass.

    Without hulls of its own the hull of all vertices stands for it. The triangles need not be closed.
    """

    type: Literal["mesh"] = "mesh"
    vertices: tuple[Point3, ...] = Field(min_length=4, max_length=MAX_VERTICES)
    faces: tuple[tuple[int, int, int], ...] = Field(min_length=1, max_length=2 * MAX_VERTICES)
    hulls: tuple[tuple[Point3, ...], ...] = Field(default=(), max_length=MAX_HULLS)

    unscaled: ClassVar[tuple[str, ...]] = (*BaseShape.unscaled, "faces")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        corners = np.array(self.faces)
        if corners.min() < 0 or corners.max() >= len(self.vertices):
            raise ValueError("mesh faces name vertices that are not there")
        self.pieces()
        return self

    def pieces(self) -> list[Piece]:
        """Return the hulls."""
        return [polytope(np.array(points)) for points in self.hulls or (self.vertices,)]

    def surface(self) -> tuple[NDArray, NDArray]:
        """Return the triangles: vertices [v, 3] and faces [f, 3]."""
        return np.array(self.vertices), np.array(self.faces, np.int64)


__all__ = ["HELPER", "UNKNOWN", "Mesh"]

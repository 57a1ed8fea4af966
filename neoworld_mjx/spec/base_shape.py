"""Base of all shapes: convex pieces, surface, volume and signed distance."""

from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from .base import Number, ScalableSpec
from .convex import Piece, mass_properties
from .dimensions import LENGTH, UNSCALED
from .pose import ArrayLike
from .triangles import distance_to_triangles, enclosed_volume

Point2 = Annotated[tuple[Number, Number], LENGTH]
Face = Literal["+x", "-x", "+y", "-y", "+z", "-z"]

MIN_SECTORS, MAX_SECTORS = 6, 64
Sectors = Annotated[int, Field(ge=MIN_SECTORS, le=MAX_SECTORS), UNSCALED]


class BaseShape(ScalableSpec):
    """Base of all shapes.

    A shape defines its convex pieces and its surface. Volume and distance follow from the surface,
    or from a formula if the shape has one. Both describe the true solid, not its colliders.
    """

    def build_pieces(self) -> list[Piece]:
        """Compute the convex pieces; see `pieces`."""
        raise NotImplementedError

    def pieces(self) -> list[Piece]:
        """Return the convex pieces, which do not overlap, in the shape's frame."""
        return list(_shared_pieces(self))  # pyright: ignore[reportArgumentType] as in `surface`

    def primitive(self) -> Piece | None:
        """Return the shape as a primitive piece, or None if it is not a primitive."""
        return None

    def build_surface(self) -> tuple[NDArray, NDArray]:
        """Compute the surface; see `surface`."""
        raise NotImplementedError

    def surface(self) -> tuple[NDArray, NDArray]:
        """Return the closed surface in the shape's frame; normals point outwards.

        Rendering and exported visuals use the surface, which is one watertight mesh. Physics uses
        the pieces, which may be coarser.

        Returns:
            Vertices [m], float64 [v, 3], and triangles, int64 [f, 3], counterclockwise as seen from
            outside. The arrays are shared and read-only.
        """
        return _shared_surface(self)  # pyright: ignore[reportArgumentType] frozen models have a hash

    def volume(self) -> float:
        """Return the volume [m^3]."""
        return enclosed_volume(*self.surface())

    def signed_distance(self, points: ArrayLike) -> NDArray:
        """Return the distances [m] of points [m] to the surface, negative inside, shape [n]."""
        return distance_to_triangles(as_points(points), *self.surface())


class Primitive(BaseShape):
    """Base of shapes that correspond to a geom type of MuJoCo."""

    def primitive(self) -> Piece:
        """Return the shape as a piece."""
        raise NotImplementedError

    def build_pieces(self) -> list[Piece]:
        """Return the primitive as the only piece."""
        return [self.primitive()]

    def volume(self) -> float:
        """Return the volume [m^3]."""
        return mass_properties(self.primitive())[0]


@lru_cache(maxsize=1024)
def _shared_pieces(shape: BaseShape) -> tuple[Piece, ...]:
    return tuple(shape.build_pieces())


@lru_cache(maxsize=1024)
def _shared_surface(shape: BaseShape) -> tuple[NDArray, NDArray]:
    vertices, faces = shape.build_surface()
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return vertices, faces


def as_points(points: ArrayLike) -> NDArray:
    """Return points as an array [n, 3]."""
    return np.atleast_2d(np.asarray(points, float))

"""Appearance of environment supports: the outline from above, and the surface."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base import Name, Spec
from .extruded import crossing_edges
from .outlines import polygon_area
from .surface_pattern import RGB, SurfacePattern

ROUND_CORNERS = 32
"""Number of corners of the polygon that approximates an ellipse."""
MOST_CORNERS = 24
LEAST_AREA = 0.05
"""Smallest area of a polygon, relative to the area of its box."""
LEAST_EDGE = 0.005
"""Smallest length of an edge, in units of the box."""
OUTLINE_SLACK = 0.02
"""Largest distance between the bounds of a polygon and its box, in units of the box."""

Coordinate = Annotated[float, Field(ge=-0.5 - OUTLINE_SLACK, le=0.5 + OUTLINE_SLACK)]


class SupportOutline(Spec):
    """Outline of a support seen from above, in units of its box.

    x and y run from -0.5 to 0.5 along the length and the width of the box, in the support's frame.
    """

    shape: Literal["rectangle", "round", "polygon"] = "rectangle"
    points: tuple[tuple[Coordinate, Coordinate], ...] = Field(default=(), max_length=MOST_CORNERS)
    """Corners of a polygon in order; empty for all other shapes."""

    @model_validator(mode="after")
    def _simple(self) -> "SupportOutline":
        if self.shape != "polygon":
            if self.points:
                raise ValueError(f"outline of shape {self.shape} has no points; a polygon has")
            return self
        if len(self.points) < 3:
            raise ValueError(
                f"outline of shape polygon needs 3 to {MOST_CORNERS} points, got {len(self.points)}"
            )
        p = np.array(self.points)
        edges = np.linalg.norm(np.roll(p, -1, axis=0) - p, axis=1)
        if edges.min() < LEAST_EDGE:
            k = int(edges.argmin())
            raise ValueError(
                f"outline points {k} and {(k + 1) % len(p)} are the same; name each corner once"
            )
        crossing = crossing_edges([p])
        if crossing is not None:
            raise ValueError(
                f"outline crosses or touches itself: the edges from points {crossing[0]} and "
                f"{crossing[1]} do; list the corners in order around it"
            )
        if abs(polygon_area(p)) < LEAST_AREA:
            raise ValueError(
                f"outline encloses {abs(polygon_area(p)):.3f} of its box, needs {LEAST_AREA:g}"
            )
        low, high = p.min(axis=0), p.max(axis=0)
        if np.abs(low + 0.5).max() > OUTLINE_SLACK or np.abs(high - 0.5).max() > OUTLINE_SLACK:
            raise ValueError(
                f"outline reaches x {low[0]:g} .. {high[0]:g} and y {low[1]:g} .. {high[1]:g}; "
                "both must reach from -0.5 to 0.5, as size is the length and width of the outline"
            )
        return self

    def corners(self) -> NDArray:
        """Return the corners [n, 2] in units of the box, counterclockwise."""
        if self.shape == "rectangle":
            return np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        if self.shape == "round":
            turn = 2 * np.pi * np.arange(ROUND_CORNERS) / ROUND_CORNERS
            return np.column_stack([np.cos(turn), np.sin(turn)]) / 2
        p = np.array(self.points)
        low, high = p.min(axis=0), p.max(axis=0)
        p = (p - low) / (high - low) - 0.5
        return p if polygon_area(p) > 0 else p[::-1]


RECTANGLE = SupportOutline()


class SupportSurface(Spec):
    """Material, pattern and color of a support."""

    material: Name
    """Name of a material that programs can use by name."""
    pattern: SurfacePattern
    rgb: RGB | None = None
    """Parsed color. The color measured in the photograph takes precedence if enough of the support
    is visible."""

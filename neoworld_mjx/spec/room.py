"""Appearance of surfaces: outlines of environment supports, patterns, prints of the photograph."""

from typing import Annotated, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base import Name, ScalableSpec, Spec, Vec3
from .dimensions import LENGTH, UNSCALED, Dimension, Scaling
from .extruded import crossing_edges
from .triangles import polygon_area

RoomPatternKind = Literal[
    "plain", "grain", "boards", "tiles", "bricks", "veins", "speckles", "weave"
]
"""Patterns of floors and walls."""
PatternKind = Literal[RoomPatternKind, "brushed", "checker"]
PATTERN_KINDS: tuple[PatternKind, ...] = get_args(PatternKind)
Share = Annotated[float, Field(ge=0, le=1)]
RGB = tuple[Share, Share, Share]

STEPS_M: dict[PatternKind, float] = {
    "plain": 1.0,
    "grain": 0.1,
    "boards": 0.12,
    "tiles": 0.30,
    "bricks": 0.075,
    "veins": 0.25,
    "speckles": 0.010,
    "weave": 0.002,
    "brushed": 0.002,
    "checker": 0.05,
}
"""Default step of each kind [m]."""


class SurfacePattern(ScalableSpec):
    """Pattern of a material. Physics ignores patterns."""

    kind: PatternKind
    rgb: Annotated[RGB, UNSCALED] | None = None
    """Color of joints, veins, speckles, scratches or gaps of the weave; if None, a darker shade of
    the material's color."""
    step: Annotated[float, Field(gt=0, le=10), LENGTH] | None = None
    """Width of a board, edge of a tile, height of a brick, or spacing of veins, speckles, scratches
    or threads [m]; if None, the value in STEPS_M."""
    along: Literal["x", "y"] = "x"
    """Direction of boards and courses: the first ("x") or the second ("y") axis of a face. The axes
    are x and y on top, y and z on front and back, and x and z on the sides."""

    @property
    def length(self) -> float:
        """The step or, if None, the default step of the kind [m]."""
        return self.step or STEPS_M[self.kind]


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


PER_LENGTH = Scaling(Dimension(length=-1))
Encoded = Annotated[str, Field(max_length=4_000_000, pattern=r"^[A-Za-z0-9+/]*={0,2}$")]
Row = Annotated[Vec3, PER_LENGTH]


class PhotoPrint(ScalableSpec):
    """A window of the photograph, projected onto the surfaces that its camera saw.

    A point p in the object's frame with all joints at zero [m] has the window coordinates u and v
    and the depth w, where turn p + shift = (u w, v w, w). In the window, u points to the right and
    v points down, both from 0 to 1. The camera saw the point if w equals the depth of the window at
    (u, v). The colors include the lighting of the photograph.
    """

    image: Encoded
    """Window of the photograph, as base64 of a PNG; inpainted where other objects occluded the
    object."""
    depth: Encoded
    """Depths, as base64 of a 16-bit PNG: 0 where the object is not visible, otherwise 1 (near) to
    65535 (far)."""
    near: Annotated[float, Field(gt=0, allow_inf_nan=False), UNSCALED]
    """Depth that the value 1 encodes [m], in the photographed scene; scaling does not change it."""
    far: Annotated[float, Field(gt=0, allow_inf_nan=False), UNSCALED]
    """Depth that the value 65535 encodes [m]."""
    turn: tuple[Row, Row, Row]
    """Matrix of the projection, by rows [1/m]."""
    shift: Annotated[Vec3, UNSCALED]

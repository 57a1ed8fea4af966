"""Pattern of a surface: boards, tiles, veins of stone, a weave, brushed metal."""

from typing import Annotated, Literal, get_args

from pydantic import Field

from .base import ScalableSpec
from .dimensions import LENGTH, UNSCALED

RoomPatternKind = Literal[
    "plain", "grain", "boards", "tiles", "bricks", "veins", "speckles", "weave"
]
"""Patterns of floors and walls."""
PatternKind = Literal[RoomPatternKind, "brushed"]
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
    "weave": 0.008,
    "brushed": 0.002,
}
"""Default step of each kind [m]."""


class SurfacePattern(ScalableSpec):
    """Pattern of a material; physics ignores it."""

    kind: PatternKind
    rgb: Annotated[RGB, UNSCALED] | None = None
    """Colour of joints, veins, speckles, scratches or the weave's gaps; None darkens the material's
    colour."""
    step: Annotated[float, Field(gt=0, le=10), LENGTH] | None = None
    """Width of a board, edge of a tile, height of a brick, distance of veins, speckles, scratches
    or threads [m]; None uses the default."""
    along: Literal["x", "y"] = "x"
    """Direction of boards and courses: a face's first axis ("x") or its second ("y"). The axes are
    x and y on top, y and z on front and back, x and z on the sides."""

    @property
    def length(self) -> float:
        """The step, or its default [m]."""
        return self.step or STEPS_M[self.kind]

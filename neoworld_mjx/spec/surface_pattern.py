"""Pattern of a surface, such as boards, tiles, veins of stone, a weave, or brushed metal."""

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

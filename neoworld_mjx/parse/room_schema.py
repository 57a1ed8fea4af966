"""Schema of the outline and the surface of supports in a response.

Names, docstrings and descriptions of the classes are part of the request, as in `schema`.
"""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..spec import SupportOutline, SupportSurface, SurfacePattern
from ..spec.surface_pattern import RGB, RoomPatternKind


class ResponsePart(BaseModel):
    """Base class of the parts of a response; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid")


class ParsedOutlinePoint(ResponsePart):
    """A corner of an outline, from the middle of the footprint, in fractions of the size."""

    x: float = Field(description="-0.5 at its back, 0.5 at its front.")
    y: float = Field(description="-0.5 at its right side, 0.5 at its left side.")


class ParsedOutline(ResponsePart):
    """Outline of a support of the environment, seen from above."""

    shape: Literal["rectangle", "round", "polygon"] = Field(
        description="round: a circle or an ellipse that fills length and width."
    )
    points: list[ParsedOutlinePoint] = Field(
        default_factory=list,
        description="Only for polygon: its 3 to 24 corners in order around it. They extend from "
        "-0.5 to 0.5 along both axes.",
    )


class ParsedSurface(ResponsePart):
    """Material and pattern of the visible face of a support of the environment."""

    material: Literal[
        "wood",
        "stone",
        "concrete",
        "brick",
        "ceramic",
        "steel",
        "glass",
        "plastic",
        "fabric",
        "paper",
        "soil",
    ] = Field(
        description="Material of the face itself: fabric is carpet or cloth, ceramic is tiles, "
        "plastic includes laminate, vinyl and thick paint, concrete includes plaster."
    )
    pattern: RoomPatternKind = Field(
        default="plain",
        description="grain: of a single piece of wood; boards: side by side; veins: of stone; "
        "speckles: of terrazzo or granite; weave: of carpet or cloth.",
    )
    colour: list[float] | None = Field(
        default=None,
        description="Red, green, blue from 0 to 1 as in white light. It is used where the picture "
        "hardly shows the face; otherwise the colour is measured in the picture.",
    )
    second_colour: list[float] | None = Field(
        default=None, description="Colour of joints, veins, speckles or the weave's gaps."
    )
    step: float | None = Field(
        default=None,
        description="Width of a board, edge of a tile, height of a brick, spacing of veins, "
        "speckles or threads [m]; null for the usual value.",
    )
    run: Literal["along_length", "along_width", "level", "upright"] | None = Field(
        default=None,
        description="Direction of boards and courses: along the support's length or width, or on a "
        "wall level or upright; null for along its length, or level.",
    )


def support_surface(surface: ParsedSurface | None) -> SupportSurface | None:
    """Convert a surface; return None for None.

    Raises:
        ValueError: a color is invalid.
    """
    if surface is None:
        return None
    first, second = surface_colours(surface)
    pattern = SurfacePattern(
        kind=surface.pattern,
        rgb=second,
        step=surface.step,
        # The second axis of the face is the width of a floor and the vertical of a wall.
        along="y" if surface.run in ("along_width", "upright") else "x",
    )
    return SupportSurface(material=surface.material, pattern=pattern, rgb=first)


def surface_colours(surface: ParsedSurface) -> tuple[RGB | None, RGB | None]:
    """Return both colors of a surface.

    Raises:
        ValueError: a color is invalid; the message is written for the model.
    """
    first = None if surface.colour is None else _rgb("colour", surface.colour)
    second = surface.second_colour
    return first, None if second is None else _rgb("second_colour", second)


def _rgb(field: str, colour: list[float]) -> tuple[float, float, float]:
    if len(colour) != 3:
        raise ValueError(f"surface.{field} must be three numbers, got {len(colour)}")
    red, green, blue = colour
    return red, green, blue


def support_outline(outline: ParsedOutline | None) -> SupportOutline:
    """Convert an outline; return a rectangle for None.

    Raises:
        ValueError: a polygon is invalid; the message is written for the model.
    """
    if outline is None:
        return SupportOutline()
    points = tuple((point.x, point.y) for point in outline.points)
    try:
        return SupportOutline(shape=outline.shape, points=points)
    except ValidationError as error:
        raise ValueError(error_line(error)) from None


def support_problems(
    environment: bool,
    furniture: bool,
    outline: ParsedOutline | None,
    surface: ParsedSurface | None,
) -> list[str]:
    """Return the errors of the fields that only supports of the environment may have.

    Args:
        environment: if True, the object is a support of the environment.
        furniture: if True, a program builds the object's shape from the picture.
        outline: outline of the object.
        surface: surface of the object.
    """
    declared = {"outline": outline, "surface": surface}
    given = [name for name, value in declared.items() if value is not None]
    if not environment:
        problems = [f"{name} is for environment supports only; leave it null" for name in given]
        if furniture:
            problems.append("furniture is for environment supports only; every object is built")
        return problems
    if furniture and given:
        return [f"furniture is built from the picture; leave {' and '.join(given)} null"]
    try:
        support_outline(outline)
        if surface is not None:
            surface_colours(surface)
    except ValueError as error:
        return [str(error)]
    return []


def error_line(error: ValidationError) -> str:
    """Return all errors of a validation as one line, each with its path."""
    lines = []
    for problem in error.errors():
        where = ".".join(str(step) for step in problem["loc"])
        message = problem["msg"].removeprefix("Value error, ")
        lines.append(f"{where}: {message}" if where else message)
    return "; ".join(lines)

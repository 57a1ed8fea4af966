"""Schema of the camera and the objects in the reasoner's response, in pixels and degrees.

Names, docstrings and descriptions of the classes are part of the request: a change invalidates the
recorded tapes. The JSON schema contains no bounds, because some servers reject schemas with bounds.
Validators check the bounds, and their errors are sent back to the model.
"""

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from ..io.names import NAME_RULE, RESERVED, is_name
from ..spec import SupportOutline, SupportSurface, SurfacePattern
from ..spec.room import RGB, RoomPatternKind
from ..spec.tree import Relation

MAX_LISTED, MAX_OBJECTS = 200, 100
"""Maximum number of entries of a list in a response, and of its list `objects`."""


def _between(low: float, high: float) -> AfterValidator:
    def check(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(f"must lie in {low:g} .. {high:g}, got {value:g}")
        return value

    return AfterValidator(check)


def _three(value: list[float]) -> list[float]:
    if len(value) != 3:
        raise ValueError(f"must be three numbers, got {len(value)}")
    return value


def _name(value: str) -> str:
    if not is_name(value):
        raise ValueError(f"a name has {NAME_RULE}")
    if value in RESERVED:
        raise ValueError("MuJoCo reserves this name, choose another")
    return value


Meters = Annotated[float, _between(-1000.0, 1000.0)]
Edge = Annotated[float, _between(1e-4, 1000.0)]
Pixel = Annotated[float, _between(-1e5, 1e5)]
Degrees = Annotated[float, _between(-720.0, 720.0)]
FieldOfView = Annotated[float, _between(1.0, 170.0)]
Fraction = Annotated[float, _between(0.0, 1.0)]
Centered = Annotated[float, _between(-1.0, 1.0)]
Colour = Annotated[list[Fraction], AfterValidator(_three)]
CheckedName = Annotated[str, AfterValidator(_name)]


class ResponsePart(BaseModel):
    """Base class of the parts of a response; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid")

    @model_validator(mode="after")
    def _short_lists(self) -> "ResponsePart":
        for field in type(self).model_fields:
            value = getattr(self, field)
            most = MAX_OBJECTS if field == "objects" else MAX_LISTED
            if isinstance(value, list) and len(value) > most:
                raise ValueError(f"{field} lists {len(value)} entries, at most {most} are accepted")
        return self


class ParsedCamera(ResponsePart):
    """The camera that took the picture."""

    pitch_deg: Annotated[float, _between(-90.0, 90.0)] = Field(
        description="Angle below the horizontal: 0 is level, 90 straight down [degrees]."
    )
    height: Meters = Field(description="Height of the camera above z = 0 [m].")
    fovy_deg: FieldOfView = Field(
        description="Vertical field of view of the whole picture [degrees]."
    )
    roll_deg: Degrees = Field(
        default=0.0,
        description="Clockwise roll of the camera, which turns the picture anticlockwise; 0 if "
        "verticals are upright [degrees].",
    )
    measured: list[Literal["pitch_deg", "height", "fovy_deg", "roll_deg"]] = Field(
        default_factory=list,
        description="The numbers above that you measured in the picture, from vanishing points, "
        "ellipses or several known sizes; the others count as guesses.",
    )
    pitch_doubt_deg: Annotated[float, _between(0.0, 57.0)] | None = Field(
        default=None,
        description="Uncertainty of `pitch_deg`: two times in three the error is smaller "
        "[degrees]; null if you cannot estimate it.",
    )
    height_doubt: Fraction | None = Field(
        default=None,
        description="The same of `height`, as a fraction of it: 0.1 is ten per cent.",
    )


class ParsedBox(ResponsePart):
    """Tight box around the visible pixels, in pixels of the picture shown."""

    left: Pixel
    top: Pixel
    right: Pixel
    bottom: Pixel


class ParsedPosition(ResponsePart):
    """The middle of the object's footprint, at the height of its lowest point [m]."""

    x: Meters = Field(description="Distance ahead of the camera.")
    y: Meters = Field(
        description="Distance to the left of the camera's axis; negative to the right."
    )
    z: Meters = Field(description="Height of the object's lowest point.")


class ParsedSize(ResponsePart):
    """Outer size of the whole object, hidden parts included, moving parts as open as seen [m]."""

    length: Edge = Field(description="Along the object's own x axis: from its back to its front.")
    width: Edge = Field(description="Along its own y axis: from its right side to its left side.")
    height: Edge = Field(description="Along its own z axis.")


class ParsedTilt(ResponsePart):
    """Tilt of the object from its usual upright pose."""

    towards: Literal["forward", "backward", "left", "right"] = Field(
        description="Direction in which its top has moved, seen from the object itself."
    )
    degrees: Degrees = Field(description="Angle of the tilt: 90 is lying, 180 upside down.")


class ParsedPixel(ResponsePart):
    """A pixel of the picture shown."""

    u: Pixel = Field(description="Position to the right.")
    v: Pixel = Field(description="Position downwards.")


class ParsedDoubt(ResponsePart):
    """Uncertainty of your numbers: two times in three the error is smaller than this."""

    position: Annotated[float, _between(1e-6, 1000.0)] | None = Field(
        default=None, description="Error of `position` along the ground [m]."
    )
    size: Annotated[float, _between(1e-6, 10.0)] | None = Field(
        default=None, description="Error of `size`, as a fraction of it: 0.1 is ten per cent."
    )
    yaw_deg: Annotated[float, _between(1e-6, 360.0)] | None = Field(
        default=None, description="Error of `yaw_deg` [degrees]."
    )


class ParsedPart(ResponsePart):
    """A part that can move, and how far it is open in the picture."""

    part: CheckedName = Field(description="Name, such as drawer_top, door, lid.")
    motion: Literal["revolute", "continuous", "prismatic"] = Field(
        description="revolute: a hinge with limits; continuous: turns all the way round; "
        "prismatic: slides."
    )
    opening: Fraction = Field(default=0.0, description="0 closed, 1 fully open.")


class ParsedOutlinePoint(ResponsePart):
    """A corner of an outline, from the middle of the footprint, in fractions of the size."""

    x: Centered = Field(description="-0.5 at its back, 0.5 at its front.")
    y: Centered = Field(description="-0.5 at its right side, 0.5 at its left side.")


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

    def converted(self) -> SupportOutline:
        """Return the outline of a scene tree.

        Raises:
            ValueError: the polygon is invalid; the message is written for the model.
        """
        points = tuple((point.x, point.y) for point in self.points)
        try:
            return SupportOutline(shape=self.shape, points=points)
        except ValidationError as error:
            raise ValueError(error_line(error)) from None


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
    colour: Colour | None = Field(
        default=None,
        description="Red, green, blue from 0 to 1 as in white light. It is used where the picture "
        "hardly shows the face; otherwise the colour is measured in the picture.",
    )
    second_colour: Colour | None = Field(
        default=None, description="Colour of joints, veins, speckles or the weave's gaps."
    )
    step: Annotated[float, _between(1e-4, 10.0)] | None = Field(
        default=None,
        description="Width of a board, edge of a tile, height of a brick, spacing of veins, "
        "speckles or threads [m]; null for the usual value.",
    )
    run: Literal["along_length", "along_width", "level", "upright"] | None = Field(
        default=None,
        description="Direction of boards and courses: along the support's length or width, or on a "
        "wall level or upright; null for along its length, or level.",
    )

    def converted(self) -> SupportSurface:
        """Return the surface of a scene tree."""
        pattern = SurfacePattern(
            kind=self.pattern,
            rgb=_rgb(self.second_colour),
            step=self.step,
            # The second axis of the face is the width of a floor and the vertical of a wall.
            along="y" if self.run in ("along_width", "upright") else "x",
        )
        return SupportSurface(material=self.material, pattern=pattern, rgb=_rgb(self.colour))


class ParsedObject(ResponsePart):
    """One object, or one support of the environment."""

    name: CheckedName = Field(
        description="Unique; letters, digits and underscores, a letter first."
    )
    label: str = Field(description="Kind of object, in one to three words, such as coffee cup.")
    description: str = Field(
        description="Shape, parts, material and colours, for someone who has to build it."
    )
    environment: bool = Field(
        default=False,
        description="True if it belongs to the environment and never moves: floor, wall, table, "
        "counter, shelf.",
    )
    parent: str | None = Field(
        description="Name of the object that supports it; null for the floor, a wall, and a slab "
        "of the environment that stands on nothing listed, such as a table top without its legs."
    )
    relation: Relation = Field(
        default="on",
        description="on: rests on it; in: rests inside it; attached: fastened to it; leaning: "
        "stands on it and leans against something.",
    )
    leans_on: str | None = Field(
        default=None,
        description="Only for `leaning`: name of the listed object that it leans against.",
    )
    parent_link: str | None = Field(
        default=None,
        description="The movable part of the parent that supports it, such as an open drawer.",
    )
    fixed_base: bool = Field(
        default=False,
        description="True if it never moves as a whole: built in, screwed down, or too heavy for a "
        "robot arm.",
    )
    occluded: bool = Field(
        default=False,
        description="True if another object or the picture's edge hides a part of it.",
    )
    occluded_by: list[str] = Field(
        default_factory=list, description="Names of the listed objects that hide a part of it."
    )
    box: ParsedBox
    position: ParsedPosition
    size: ParsedSize
    yaw_deg: Degrees = Field(
        default=0.0,
        description="Direction of its front, seen from above, anticlockwise: 0 away from the "
        "camera, 90 to the left, 180 towards the camera, -90 to the right [degrees].",
    )
    tilt: ParsedTilt | None = Field(
        default=None, description="null if it stands upright or lies as such objects usually do."
    )
    articulation: list[ParsedPart] = Field(
        default_factory=list, description="Every part that can move, including closed ones."
    )
    held_by: str | None = Field(
        default=None,
        description="Only for `attached`. null: it is fastened and stays (screwed, nailed, glued, "
        "hung up permanently). Otherwise what holds it although it can come off, such as the hook "
        "that its loop hangs over; it then stays only if its shape and its parent's shape hold it.",
    )
    contact: ParsedPixel | None = Field(
        default=None,
        description="The pixel at which it touches its support; of several, the one nearest to the "
        "camera, so the lowest in the picture. null if no point of contact is visible.",
    )
    cut_sides: list[Literal["left", "top", "right", "bottom"]] | None = Field(
        default=None,
        description="Sides of `box` at which the object continues, hidden by another object or cut "
        "off by the picture's edge. [] if all four show its own outline; null if unknown.",
    )
    known_size: list[Literal["length", "width", "height"]] = Field(
        default_factory=list,
        description="Edges of `size` that are standard for such objects (a soda can is 12.2 cm "
        "high, A4 paper 29.7 cm long) and not judged from this picture.",
    )
    doubt: ParsedDoubt | None = Field(
        default=None, description="Uncertainty of the numbers; null if you cannot estimate it."
    )
    outline: ParsedOutline | None = Field(
        default=None,
        description="Only for supports of the environment: shape seen from above; null if it is a "
        "rectangle.",
    )
    surface: ParsedSurface | None = Field(
        default=None, description="Only for supports of the environment: material, pattern, colour."
    )
    furniture: bool = Field(
        default=False,
        description="True for a support of the environment that is built from the picture in its "
        "real shape, such as a table with legs that stands on a listed floor.",
    )

    @model_validator(mode="after")
    def _consistent(self) -> "ParsedObject":
        box, given = self.box, [n for n in ("outline", "surface") if getattr(self, n) is not None]
        if box.left >= box.right or box.top >= box.bottom:
            raise ValueError("box needs left < right and top < bottom")
        if self.leans_on is not None and self.relation != "leaning":
            raise ValueError("leans_on is for the relation leaning only")
        if self.leans_on is not None and self.leans_on in (self.name, self.parent):
            raise ValueError(
                "leans_on names what it leans against, not itself or what it stands on"
            )
        if self.furniture and given:
            raise ValueError(
                f"furniture is built from the picture; leave {' and '.join(given)} null"
            )
        if self.outline is not None:
            self.outline.converted()
        return self


def error_line(error: ValidationError) -> str:
    """Return all errors of a validation as one line, each with its path."""
    lines = []
    for problem in error.errors():
        where = ".".join(str(step) for step in problem["loc"])
        message = problem["msg"].removeprefix("Value error, ")
        lines.append(f"{where}: {message}" if where else message)
    return "; ".join(lines)


def _rgb(colour: list[float] | None) -> RGB | None:
    if colour is None:
        return None
    red, green, blue = colour
    return red, green, blue

"""Schema of the camera and the objects in the reasoner's response, in pixels and degrees.

Names, docstrings and descriptions of the classes are part of the request: a change invalidates the
recorded tapes.
"""

from typing import Literal

from pydantic import Field

from ..spec.tree import Relation
from .room_schema import ParsedOutline, ParsedSurface, ResponsePart


class ParsedCamera(ResponsePart):
    """The camera that took the picture."""

    pitch_deg: float = Field(
        description="Angle below the horizontal: 0 is level, 90 straight down [degrees]."
    )
    height: float = Field(description="Height of the camera above z = 0 [m].")
    fovy_deg: float = Field(description="Vertical field of view of the whole picture [degrees].")
    roll_deg: float = Field(
        default=0.0,
        description="Clockwise roll of the camera, which turns the picture anticlockwise; 0 if "
        "verticals are upright [degrees].",
    )
    measured: list[Literal["pitch_deg", "height", "fovy_deg", "roll_deg"]] = Field(
        default_factory=list,
        description="The numbers above that you measured in the picture, from vanishing points, "
        "ellipses or several known sizes; the others count as guesses.",
    )
    pitch_doubt_deg: float | None = Field(
        default=None,
        description="Uncertainty of `pitch_deg`: two times in three the error is smaller "
        "[degrees]; null if you cannot estimate it.",
    )
    height_doubt: float | None = Field(
        default=None,
        description="The same of `height`, as a fraction of it: 0.1 is ten per cent.",
    )


class ParsedBox(ResponsePart):
    """Tight box around the visible pixels, in pixels of the picture shown."""

    left: float
    top: float
    right: float
    bottom: float


class ParsedPosition(ResponsePart):
    """The middle of the object's footprint, at the height of its lowest point [m]."""

    x: float = Field(description="Distance ahead of the camera.")
    y: float = Field(
        description="Distance to the left of the camera's axis; negative to the right."
    )
    z: float = Field(description="Height of the object's lowest point.")


class ParsedSize(ResponsePart):
    """Outer size of the whole object, hidden parts included, moving parts as open as seen [m]."""

    length: float = Field(description="Along the object's own x axis: from its back to its front.")
    width: float = Field(description="Along its own y axis: from its right side to its left side.")
    height: float = Field(description="Along its own z axis.")


class ParsedTilt(ResponsePart):
    """Tilt of the object from its usual upright pose."""

    towards: Literal["forward", "backward", "left", "right"] = Field(
        description="Direction in which its top has moved, seen from the object itself."
    )
    degrees: float = Field(description="Angle of the tilt: 90 is lying, 180 upside down.")


class ParsedPixel(ResponsePart):
    """A pixel of the picture shown."""

    u: float = Field(description="Position to the right.")
    v: float = Field(description="Position downwards.")


class ParsedDoubt(ResponsePart):
    """Uncertainty of your numbers: two times in three the error is smaller than this."""

    position: float | None = Field(
        default=None, description="Error of `position` along the ground [m]."
    )
    size: float | None = Field(
        default=None, description="Error of `size`, as a fraction of it: 0.1 is ten per cent."
    )
    yaw_deg: float | None = Field(default=None, description="Error of `yaw_deg` [degrees].")


class ParsedPart(ResponsePart):
    """A part that can move, and how far it is open in the picture."""

    part: str = Field(description="Name, such as drawer_top, door, lid.")
    motion: Literal["revolute", "continuous", "prismatic"] = Field(
        description="revolute: a hinge with limits; continuous: turns all the way round; "
        "prismatic: slides."
    )
    opening: float = Field(default=0.0, description="0 closed, 1 fully open.")


class ParsedObject(ResponsePart):
    """One object, or one support of the environment."""

    name: str = Field(description="Unique; letters, digits and underscores, a letter first.")
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
    yaw_deg: float = Field(
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

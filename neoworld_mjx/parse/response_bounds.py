"""Bounds of every number in the reasoner's response.

The JSON schema does not contain the bounds, because some servers reject schemas with bounds. If a
number is outside its bounds, the model receives an error.
"""

from collections.abc import Iterator

from pydantic import BaseModel

from ..io.names import MAX_NAME, plain_text

FURTHEST_M, LARGEST_M, THINNEST_M = 1000.0, 1000.0, 1e-4
MAX_LISTED, MAX_OBJECTS = 200, 100
_POSITION, _EDGE = (-FURTHEST_M, FURTHEST_M), (THINNEST_M, LARGEST_M)
_PIXEL, _ANGLE, _FRACTION = (-1e5, 1e5), (-720.0, 720.0), (-1.0, 1.0)
BOUNDS: dict[str, tuple[float, float]] = {
    **{f"position.{axis}": _POSITION for axis in "xyz"},
    **{f"size.{edge}": _EDGE for edge in ("length", "width", "height")},
    **{f"box.{side}": _PIXEL for side in ("left", "top", "right", "bottom")},
    **{"contact.u": _PIXEL, "contact.v": _PIXEL},
    **{"yaw_deg": _ANGLE, "tilt.degrees": _ANGLE},
    **{"articulation.opening": (0.0, 1.0)},
    **{"outline.points.x": _FRACTION, "outline.points.y": _FRACTION},
    **{"surface.step": (THINNEST_M, 10.0)},
    **{"surface.colour": (0.0, 1.0), "surface.second_colour": (0.0, 1.0)},
    **{"doubt.position": (1e-6, FURTHEST_M), "doubt.size": (1e-6, 10.0)},
    **{"doubt.yaw_deg": (1e-6, 360.0)},
    **{
        "camera.pitch_doubt_deg": (0.0, 57.0),
        "camera.height_doubt": (0.0, 1.0),
        "camera.pitch_deg": (-90.0, 90.0),
        "camera.roll_deg": _ANGLE,
    },
    **{"camera.fovy_deg": (1.0, 170.0), "camera.height": _POSITION},
}
"""Minimum and maximum of each number [m, degrees, pixels or fractions], by its path. Paths of an
object's numbers start at the object, and all other paths at the response."""


def out_of_bounds(response: BaseModel) -> Iterator[str]:
    """Yield an error for each number of a response that is outside its bounds."""
    for path, name, value in _numbers(response):
        low, high = BOUNDS[path]
        if not low <= value <= high:
            where = f"object {plain_text(name, MAX_NAME)}: " if name else ""
            yield f"{where}{path} must lie in {low:g} .. {high:g}, got {value:g}"


def too_long(response: BaseModel, prefix: str = "") -> Iterator[str]:
    """Yield an error for each list of a response that has too many entries."""
    for field in type(response).model_fields:
        value = getattr(response, field)
        parts = [value] if isinstance(value, BaseModel) else value
        if not isinstance(parts, list):
            continue
        most = MAX_OBJECTS if field == "objects" else MAX_LISTED
        if len(parts) > most:
            yield f"{prefix}{field} lists {len(parts)} entries, at most {most} are accepted"
            continue
        for part in parts:
            if isinstance(part, BaseModel):
                yield from too_long(part, f"{prefix}{field}.")


def _numbers(part: BaseModel, prefix: str = "", name: str = "") -> Iterator[tuple[str, str, float]]:
    """Yield the path, the name of the object, and the value of every number."""
    for field in type(part).model_fields:
        value = getattr(part, field)
        # Paths start at the object, because the error names the object separately.
        path = "" if field == "objects" else f"{prefix}{field}"
        for inner in value if isinstance(value, list) else [value]:
            if isinstance(inner, float):
                yield path, name, inner
            if isinstance(inner, BaseModel):
                owner = getattr(inner, "name", name)
                yield from _numbers(inner, f"{path}." if path else "", owner)

"""Section on the alignment of Step 4 with the photograph."""

import math
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ..evidence_lines import deviation_phrase, digits_of
from .page import elements, picture, read_json

TITLE = "The photograph"
_SOURCES = {"pixels": "pixels", "box": "2D box", "none": "composition"}
"""Words for the values of `evidence` in align.json, which determined the pose of an object."""
_CAPTION = "Outlines of the composed scene, orange, and of the aligned scene, green"
_DEPTH = (
    "Rendered minus measured distance along each pixel's ray: red where the aligned scene is "
    "farther than the depth image, blue where it is nearer, gray where nothing is measured"
)
_VIEW = (
    "Outlines in a further photograph, from its aligned camera: of the composed scene, orange, and "
    "of the aligned scene, green"
)
_NOTE = (
    "Changes from the composed to the aligned scene, each in the frame of the object's support. "
    '"Known to" states standard deviations. "Heading not seen" means that the photograph gives no '
    "information about the heading."
)


def photograph_section(folder: Path) -> Markup:
    """Return the section on the alignment; empty markup for a run without compose/align.json."""
    path = folder / "compose" / "align.json"
    if not path.is_file():
        return Markup()
    aligned = read_json(path)
    if aligned is None:
        return elements.section(TITLE, elements.missing("compose/align.json cannot be read."))
    objects = aligned["objects"]
    if not objects:
        note = "Nothing was aligned: the scene has no camera or no movable object."
        return elements.section(TITLE, elements.missing(note))
    depth_png = folder / "pictures" / "depth.png"
    heads = ["object", "placed by", "#moved, mm", "#turned, deg", "#size, %", "known to"]
    return elements.section(
        TITLE,
        elements.div(
            "pictures",
            picture(folder / "pictures" / "outlines.png", _CAPTION),
            picture(depth_png, _DEPTH) if depth_png.is_file() else "",
            *(picture(file, _VIEW) for file in sorted((folder / "pictures").glob("view_*.png"))),
        ),
        *_camera_sources(aligned),
        elements.table(heads, [_row(name, change) for name, change in objects.items()]),
        elements.paragraph(_NOTE, "dim"),
    )


def _camera_sources(aligned: dict[str, Any]) -> list[Markup]:
    """Return a table with the camera's parameters, their deviations and their sources."""
    labels = {"pitch": "pitch", "roll": "roll", "fovy": "vertical field of view"}
    camera, rows = aligned.get("camera") or {}, []
    for name, entry in camera.items():
        unit, factor = ("m", 1.0) if name == "height" else ("°", math.degrees(1.0))
        digits = 3 if name == "height" else 2
        value = round(factor * entry["value"], digits) + 0.0  # Adding 0.0 turns -0.0 into 0.0.
        deviation = max(factor * entry["deviation"], 10.0**-digits)
        texts = [f"{value:.{digits}f} {unit}", f"±{deviation:.{digits}f} {unit}"]
        rows.append([labels.get(name, name), *texts, entry["source"]])
    heads = ["camera", "#value", "#standard deviation", "known by"]
    return [elements.table(heads, rows)] if rows else []


def _row(name: str, change: dict[str, Any]) -> list[str]:
    """Return the cells of an object; the standard deviation of a change determines its digits."""
    deviations = change["uncertainty"]
    along, across = 1000 * deviations["along"], 1000 * deviations["across"]
    heading, size = math.degrees(deviations["yaw"] or 0.0), 100 * deviations["log_scale"]
    # An object on a wall moves only in the plane of the wall, so its distance has no deviation.
    least = min(along, across) if along else across
    shift_mm = 1000 * math.hypot(*change["shift_m"])
    source = _SOURCES[change["evidence"]]
    return [
        name,
        f"{source}: {change['reason']}" if change["reason"] else source,
        f"{shift_mm:.{digits_of(least)}f}",
        _signed(change["yaw_deg"], digits_of(heading)),
        _signed(100 * (change["size_ratio"] - 1), digits_of(size)),
        deviation_phrase(deviations),
    ]


def _signed(value: float, digits: int) -> str:
    rounded = round(value, digits) + 0.0  # Adding 0.0 turns -0.0 into 0.0.
    return f"{rounded:+.{digits}f}" if rounded else f"{rounded:.{digits}f}"

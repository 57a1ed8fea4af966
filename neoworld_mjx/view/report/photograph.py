"""Sections on agreement with the photograph: the alignment of Step 4, and a rescue."""

import math
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ...estimate.priors import YAW
from ...measure import object_moves
from ...spec import read_scene
from .page import elements, picture, read_json

TITLE = "The photograph"
OUTLINE_OFF = (
    "Outline off: median distance between the object's outline and the nearest edge of its colors "
    "in the photograph, in pixels of an image 640 px wide. Distances are at most 24 px; above 6 px "
    "they are rather too small. The distance is unknown if the colors of the object do not differ "
    "from those behind it."
)
"""Explanation of the distances that `_outline_off` formats."""
RESCUE_TITLE, GIVEN = "From the given poses", "given.json"
CHECKED = (
    "The shapes and poses of the objects were given. The scene as a whole was checked for "
    "penetration and for motion in free fall (below). The individual objects were not checked: no "
    "object test ran, and shapes, masses and friction are as given or assumed (see the notes)."
)
UNSEEN = 0.9
"""Ratio of a heading's standard deviation to that of its prior at and above which the photograph
counts as not showing the heading."""
_SOURCES = {"pixels": "pixels", "box": "2D box", "none": "composition"}
"""Words for the values of `evidence` in align.json, which determined the pose of an object."""
_SCENES = ("composed", "aligned")
_CAPTION = "Outlines of the composed scene, orange, and of the aligned scene, green"
_EVIDENCE = (
    "Pixels of the aligned scene: green where pixels of an object look like the object, red where "
    "they look like the background, and blue where pixels around the object look like the object"
)
_NOTE = (
    "Changes from the composed to the aligned scene, each in the frame of the object's support. "
    '"Known to" states standard deviations. "Heading not seen" means that the photograph gives no '
    "information about the heading. "
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
    outlines = aligned.get("outlines_px") or {}
    heads = ["object", "placed by", "#moved, mm", "#turned, deg", "#size, %"]
    heads += ["#outline off, composed, px", "#aligned, px"] if outlines else []
    heads += ["known to"]
    return elements.section(
        TITLE,
        elements.div(
            "pictures",
            picture(folder / "pictures" / "outlines.png", _CAPTION),
            picture(folder / "pictures" / "evidence.png", _EVIDENCE) if outlines else "",
        ),
        elements.paragraph(_camera(aligned)),
        elements.table(heads, [_row(name, change, outlines) for name, change in objects.items()]),
        elements.paragraph(_NOTE + (OUTLINE_OFF if outlines else ""), "dim"),
        *_openings(objects),
        *_dimensions(aligned),
    )


def _openings(objects: dict[str, Any]) -> list[Markup]:
    """Return a sentence about each joint that the photograph shows open."""
    return [
        elements.paragraph(f"{name}: {joint} {change['phrase']}.")
        for name, item in objects.items()
        for joint, change in item.get("joints", {}).items()
    ]


def _dimensions(aligned: dict[str, Any]) -> list[Markup]:
    """Return a table with the dimensions of programs that the alignment changed."""
    rows = [[name, freed["phrase"]] for name, freed in aligned.get("dimensions", {}).items()]
    return [elements.table(["object", "dimensions of its program"], rows)] if rows else []


def _camera(aligned: dict[str, Any]) -> str:
    """Return a sentence with the changes of the camera."""
    keys = ("pitch_deg", "roll_deg", "fovy_deg")
    pitch, roll, fovy = (_signed(aligned[key], 1) for key in keys)
    height = _signed(1000 * aligned["height_m"], 0)
    if {pitch, roll, fovy, height} == {"0.0", "0"}:
        return "The alignment did not change the camera."
    return (
        f"The alignment changed the camera's pitch (down) by {pitch}°, its roll by {roll}°, its "
        f"vertical field of view by {fovy}° and its height by {height} mm."
    )


def _row(name: str, change: dict[str, Any], outlines: dict[str, Any]) -> list[str]:
    """Return the cells of an object; the standard deviation of a change determines its digits."""
    deviations = change["uncertainty"]
    along, across = 1000 * deviations["along"], 1000 * deviations["across"]
    heading, size = math.degrees(deviations["yaw"]), 100 * deviations["log_scale"]
    # An object on a wall moves only in the plane of the wall, so its distance has no deviation.
    on_wall = along == 0
    shift_mm = 1000 * math.hypot(*change["shift_m"])
    source = _SOURCES[change["evidence"]]
    if on_wall:
        deviation_texts = [f"along the wall {_deviation(across)} mm"]
    else:
        unseen = deviations["yaw"] >= UNSEEN * YAW
        deviation_texts = [
            f"along the view {_deviation(along)} mm",
            f"across {_deviation(across)} mm",
            "heading not seen" if unseen else f"heading {_deviation(heading)}°",
        ]
    deviation_texts.append(f"size {_deviation(size)} %")
    return [
        name,
        f"{source}: {change['reason']}" if change["reason"] else source,
        f"{shift_mm:.{_digits(across if on_wall else min(along, across))}f}",
        _signed(change["yaw_deg"], _digits(heading)),
        _signed(100 * (change["size_ratio"] - 1), _digits(size)),
        *(_outline_off(outlines.get(name, {}).get(key)) for key in _SCENES if outlines),
        ", ".join(deviation_texts),
    ]


def _digits(deviation: float) -> int:
    """Return the number of decimals to show for a value with the given standard deviation."""
    return 0 if deviation >= 0.95 else 1


def _deviation(value: float) -> str:
    return f"±{max(value, 0.1):.{_digits(value)}f}"


def _signed(value: float, digits: int) -> str:
    rounded = round(value, digits) + 0.0  # Adding 0.0 turns -0.0 into 0.0.
    return f"{rounded:+.{digits}f}" if rounded else f"{rounded:.{digits}f}"


def _outline_off(value: float | None) -> str:
    """Format the distance [px] of an outline from that in the photograph; None is unknown."""
    return "unknown" if value is None else f"{value:.1f}"


def rescue_section(folder: Path) -> Markup:
    """Return the changes from the poses of another method; empty markup for any other run."""
    if not (folder / GIVEN).is_file():
        return Markup()
    if not (folder / "scene.json").is_file():
        return elements.section(RESCUE_TITLE, elements.missing("There is no refined scene."))
    moves = object_moves(read_scene(folder / GIVEN), read_scene(folder / "scene.json"))
    rows = [
        [name, f"{1e3 * m.distance_m:.1f}", f"{m.turn_deg:.1f}", f"{m.size_ratio:.3f}"]
        for name, m in moves.items()
    ]
    table = elements.table(["object", "#moved, mm", "#turned, deg", "#size ratio"], rows)
    return elements.section(RESCUE_TITLE, elements.paragraph(CHECKED), table)

"""Sections on agreement with the photograph: the alignment of Step 4, and a rescue."""

import math
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ...measure import object_moves
from ...spec import read_scene
from ..evidence_lines import CONTOUR, DEPTH, MASK, deviation_phrase, digits_of, evidence_lines
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
_SOURCES = {"pixels": "pixels", "box": "2D box", "none": "composition"}
"""Words for the values of `evidence` in align.json, which determined the pose of an object."""
_SCENES = ("composed", "aligned")
_CAPTION = "Outlines of the composed scene, orange, and of the aligned scene, green"
_EVIDENCE = (
    "Pixels of the aligned scene: green where pixels of an object look like the object, red where "
    "they look like the background, and blue where pixels around the object look like the object"
)
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
    depth_png = folder / "pictures" / "depth.png"
    heads = ["object", "placed by", "#moved, mm", "#turned, deg", "#size, %"]
    heads += ["#outline off, composed, px", "#aligned, px"] if outlines else []
    heads += ["known to"]
    return elements.section(
        TITLE,
        elements.div(
            "pictures",
            picture(folder / "pictures" / "outlines.png", _CAPTION),
            picture(folder / "pictures" / "evidence.png", _EVIDENCE) if outlines else "",
            picture(depth_png, _DEPTH) if depth_png.is_file() else "",
            *(picture(file, _VIEW) for file in sorted((folder / "pictures").glob("view_*.png"))),
        ),
        elements.paragraph(_camera(aligned)),
        *_camera_sources(aligned),
        elements.table(heads, [_row(name, change, outlines) for name, change in objects.items()]),
        elements.paragraph(_NOTE + (OUTLINE_OFF if outlines else ""), "dim"),
        *(_evidence(folder, aligned) if (folder / GIVEN).is_file() else ()),
    )


def _evidence(folder: Path, aligned: dict[str, Any]) -> list[Markup]:
    """Return a table of depth and masks for a rescue, whose report has no rows of objects."""
    supports = {o.name: o.parent or "the world" for o in read_scene(folder / GIVEN).objects}
    rows = []
    for name in aligned["objects"]:
        lines = evidence_lines(aligned, {}, name, supports.get(name, "its support"))
        rows.append([name, *(lines.get(kind, "none") for kind in (CONTOUR, DEPTH, MASK))])
    return [elements.table(["object", CONTOUR, DEPTH, MASK], rows)]


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
        *(_outline_off(outlines.get(name, {}).get(key)) for key in _SCENES if outlines),
        deviation_phrase(deviations),
    ]


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

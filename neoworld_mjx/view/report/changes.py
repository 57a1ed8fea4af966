"""Changes of each object's pose and size by the two fits and the search."""

import math
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ...measure import object_moves
from ...spec import read_scene
from .formatting import read_json, size_cm
from .page import elements

TITLE = "Parsed, fitted, refined"
RESCUE, GIVEN = "From the given poses", "given.json"
_RESCUE_NOTE = (
    "The shapes and poses of the objects were given. The scene as a whole was checked for "
    "penetration and for motion in free fall. No object test ran: shapes, masses and friction are "
    "as given or assumed (see the notes)."
)
BOXES, SHAPES, SEARCH = "fit to the boxes", "fit of the built shapes", "search"
LEAST_M, LEAST_SIZE, LEAST_DEG = 5e-4, 5e-4, 0.05
"""Changes of position [m], size (relative) and angle [deg] below which all digits shown are 0."""
_SIDES = ("left", "top", "right", "bottom")
_NOTE = (
    "Changes of position, size and heading. Both fits start from the parse; the search starts from "
    'the scene of Step 4. "Unchanged" means that all changes are below the last digit shown. If an '
    "object tilts, for example while it settles, the angle of the whole rotation is given, too. "
    "Hidden sides are sides of the 2D box that are truncated or occluded."
)


def changes(folder: Path) -> Markup:
    """Return the section with each object's parsed box, and its changes by the fits and search."""
    parsed = _parse_fit(folder)
    if not parsed:
        return elements.section(TITLE, elements.missing("There is no fit of the parse."))
    moves = all_moves(folder)
    rows = []
    for name, change in parsed.items():
        box = change["before"]
        hidden = [
            side for side, is_hidden in zip(_SIDES, change["hidden"], strict=True) if is_hidden
        ]
        rows.append(
            [
                name,
                ", ".join(f"{100 * v:.1f}" for v in box["position"]),
                size_cm(box["size"]),
                f"{math.degrees(box['yaw']):.0f}",
                *(moves[name].get(step, "") for step in (BOXES, SHAPES, SEARCH)),
                ", ".join(hidden),
            ]
        )
    heads = [
        *("object", "#parsed x, y, z, cm", "#size, cm", "#yaw, deg"),
        *(f"#{BOXES}", f"#{SHAPES}", f"#{SEARCH}", "hidden sides"),
    ]
    return elements.section(TITLE, elements.table(heads, rows), elements.paragraph(_NOTE, "dim"))


def given_moves(folder: Path) -> Markup:
    """Return the changes from the poses of another method; empty markup for any other run."""
    if not (folder / GIVEN).is_file():
        return Markup()
    if not (folder / "scene.json").is_file():
        return elements.section(RESCUE, elements.missing("There is no refined scene."))
    moves = object_moves(read_scene(folder / GIVEN), read_scene(folder / "scene.json"))
    rows = [
        [name, f"{1e3 * m.distance_m:.1f}", f"{m.turn_deg:.1f}", f"{m.size_ratio:.3f}"]
        for name, m in moves.items()
    ]
    table = elements.table(["object", "#moved, mm", "#turned, deg", "#size ratio"], rows)
    return elements.section(RESCUE, elements.paragraph(_RESCUE_NOTE), table)


def all_moves(folder: Path) -> dict[str, dict[str, str]]:
    """Return the formatted changes of the objects of a run, by object name and step."""
    refit = (read_json(folder / "compose" / "fit.json") or {}).get("objects", {})
    moves: dict[str, dict[str, str]] = {}
    for step, fitted in ((BOXES, _parse_fit(folder)), (SHAPES, refit)):
        for name, change in fitted.items():
            moves.setdefault(name, {})[step] = _fit_change(change)
    composed, refined = folder / "compose" / "scene.json", folder / "scene.json"
    if composed.is_file() and refined.is_file():
        for name, move in object_moves(read_scene(composed), read_scene(refined)).items():
            moves.setdefault(name, {})[SEARCH] = _change(
                move.distance_m, move.size_ratio, move.yaw_deg, move.turn_deg
            )
    return moves


def _parse_fit(folder: Path) -> dict[str, Any]:
    """Return the fit in the accepted round of the parse, by object name."""
    rounds = (read_json(folder / "parse.json") or {}).get("rounds", [])
    accepted = [entry for entry in rounds if entry.get("kept")]
    return (accepted[0].get("fit") or {}).get("objects", {}) if accepted else {}


def _fit_change(change: dict[str, Any]) -> str:
    if change.get("refused"):
        return "unchanged: the fit was rejected"
    ratio = math.prod(change["size_ratio"]) ** (1 / 3)
    return _change(change["distance_m"], ratio, change["yaw_deg"])


def _change(distance_m: float, size_ratio: float, yaw_deg: float, turn_deg: float = 0.0) -> str:
    """Format a change; add the angle of the whole rotation if a tilt makes it exceed the yaw."""
    tilted = turn_deg > abs(yaw_deg) + LEAST_DEG
    if (
        distance_m < LEAST_M
        and abs(size_ratio - 1) < LEAST_SIZE
        and abs(yaw_deg) < LEAST_DEG
        and not tilted
    ):
        return "unchanged"
    # Adding 0.0 turns -0.0 into 0.0.
    percent, degrees = (round(value, 1) + 0.0 for value in (100 * (size_ratio - 1), yaw_deg))
    text = f"{100 * distance_m:.1f} cm, {percent:+.1f} %, {degrees:+.1f}°"
    return f"{text}, {turn_deg:.1f}° with tilt" if tilted else text

"""Table of a report: what the parse says of each object, and what fits and search made of it."""

import math
from pathlib import Path
from typing import Any

from ...measure import object_moves
from ...spec import read_scene
from .page import Html, missing, section, table
from .tables import read_json

TITLE = "Said, fitted, searched"


def changes(folder: Path) -> Html:
    """Show who moved what: the answer's numbers, and the changes by each fit and by the search."""
    said = _kept_fit(read_json(folder / "parse.json") or {})
    if not said:
        return section(TITLE, missing("No fit of the parse yet, or it is switched off."))
    refit = (read_json(folder / "compose" / "fit.json") or {}).get("objects", {})
    searched = _searched(folder / "compose" / "scene.json", folder / "scene.json")
    rows = []
    for name, change in said.items():
        box = change["before"]
        again = refit.get(name)
        rows.append(
            [
                name,
                ", ".join(f"{100 * v:.1f}" for v in box["position"]),
                " × ".join(f"{100 * v:.1f}" for v in box["size"]),
                f"{math.degrees(box['yaw']):.0f}",
                _fitted(change),
                "" if again is None else _fitted(again),
                searched.get(name, ""),
                _hidden(change),
            ]
        )
    heads = [
        *("object", "#said: x, y, z, cm", "#size, cm", "#yaw, deg"),
        *("#fit to the boxes", "#fit of the built shapes", "#search", "not seen"),
    ]
    note = (
        '<p class="dim">Changes of place, size and heading: by both fits from what the parse says, '
        'by the search from the second; "kept" where a step left the object alone. Not seen: sides '
        "of its 2D box that are cut off or hidden.</p>"
    )
    return section(TITLE, table(heads, rows), note)


def moves_of(folder: Path, name: str) -> list[tuple[str, str]]:
    """Return what each step did to one object of a run, in words: (who, how)."""
    return all_moves(folder).get(name, [])


def all_moves(folder: Path) -> dict[str, list[tuple[str, str]]]:
    """Return what each step did to the objects of a run, in words: (who, how) by object."""
    said = _kept_fit(read_json(folder / "parse.json") or {})
    refit = (read_json(folder / "compose" / "fit.json") or {}).get("objects", {})
    searched = _searched(folder / "compose" / "scene.json", folder / "scene.json")
    moves: dict[str, list[tuple[str, str]]] = {}
    for name, change in said.items():
        moves.setdefault(name, []).append(("fit to the boxes", _fitted(change)))
    for name, change in refit.items():
        moves.setdefault(name, []).append(("fit of the built shape", _fitted(change)))
    for name, how in searched.items():
        moves.setdefault(name, []).append(("search", how))
    return moves


def _kept_fit(parse: dict[str, Any]) -> dict[str, Any]:
    kept = [entry for entry in parse.get("rounds", []) if entry.get("kept")]
    return (kept[0].get("fit") or {}).get("objects", {}) if kept else {}


def _fitted(change: dict[str, Any]) -> str:
    if change.get("refused"):
        return "kept: the fit was refused"
    ratio = math.prod(change["size_ratio"]) ** (1 / 3)
    return _phrase(change["distance_m"], ratio, change["yaw_deg"])


def _hidden(change: dict[str, Any]) -> str:
    sides = ("left", "top", "right", "bottom")
    return ", ".join(s for s, hidden in zip(sides, change["hidden"], strict=True) if hidden)


def _searched(before: Path, after: Path) -> dict[str, str]:
    """Return each object's change from the composed scene to the refined one."""
    if not (before.is_file() and after.is_file()):
        return {}
    changed = object_moves(read_scene(before), read_scene(after))
    return {name: _phrase(*move) for name, move in changed.items()}


def _phrase(distance: float, ratio: float, turn: float) -> str:
    if distance < 5e-5 and abs(ratio - 1) < 5e-4 and abs(turn) < 0.05:
        return "kept"
    percent, turned = (round(value, 1) + 0.0 for value in (100 * (ratio - 1), turn))  # No -0.0.
    return f"{100 * distance:.1f} cm, {percent:+.1f} %, {turned:+.1f}°"

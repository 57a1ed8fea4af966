"""Formatting of values in a run folder: numbers with units, supports, and the status of a run."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...errors import RunError
from ...io import read_object
from ...run_folder import STEPS

OUTLINE_OFF = (
    "Outline off: median distance between the object's outline and the nearest edge of its colors "
    "in the photograph, in pixels of an image 640 px wide. Distances are at most 24 px; above 6 px "
    "they are rather too small. The distance is unknown if the colors of the object do not differ "
    "from those behind it."
)
"""Explanation of the distances that `outline_off` formats."""


def read_json(path: Path) -> dict[str, Any] | None:
    """Read a JSON object; return None if it is missing or damaged."""
    try:
        return read_object(path, RunError) if path.is_file() else None
    except RunError:
        return None


def with_unit(value: Any, unit: Any) -> str:
    """Format the value of a check with its unit: lengths in mm, angles in degrees."""
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if unit == "m":
        return f"{1000 * value:.2f} mm"
    if unit == "rad":
        return f"{math.degrees(value):.2f}°"
    return f"{value:.4g} {unit or ''}".strip()


def mm(value: float | None) -> str:
    """Format a length in m as mm, without the unit."""
    return "" if value is None else f"{1000 * value:.2f}"


def size_cm(size: Sequence[float]) -> str:
    """Format the edge lengths of a box in cm, without the unit."""
    return " × ".join(f"{100 * edge:.1f}" for edge in size)


def support_of(entry: dict[str, Any]) -> str:
    """Format the relation to the support of a tree node or scene object, such as "on table"."""
    return f"{entry.get('relation', 'on')} {entry['parent']}" if entry.get("parent") else "world"


def progress_of(run: dict[str, Any]) -> str:
    """Return the status of a run, and its finished steps, as a clause."""
    finished = [
        step for step in STEPS if any(name.partition("/")[0] == step for name in run["steps"])
    ]
    return f"this run is {run['status']}; finished steps: {', '.join(finished) or 'none'}"


def outline_off(value: float | None) -> str:
    """Format the distance [px] of an outline from that in the photograph; None is unknown."""
    return "unknown" if value is None else f"{value:.1f}"

"""Section on a rescue: how objects moved, and how outlines agree with the photograph."""

from pathlib import Path
from typing import Any

from markupsafe import Markup

from .formatting import OUTLINE_OFF, outline_off, read_json
from .page import elements
from .pictures import picture

TITLE = "Rescue"
FILE = "rescue.json"
CHECKED = (
    "The shapes and poses of the objects were given. The scene as a whole was checked for "
    "penetration and for motion in free fall (below). The individual objects were not checked: no "
    "object test ran, and shapes, masses and friction are as given or assumed (see the notes)."
)
_CAPTION = "Outlines of the scene as given, orange, and of the rescued scene, green"


def rescue_section(folder: Path) -> Markup:
    """Return the section on a rescue; empty markup for any other run."""
    if not (folder / FILE).is_file():
        return Markup()
    rescued = read_json(folder / FILE)
    if rescued is None:
        return elements.section(TITLE, elements.missing(f"{FILE} cannot be read."))
    outlines: dict[str, dict[str, float | None]] = rescued["outlines_px"]
    heads = ["object", "#moved, mm", "#turned, deg"]
    heads += ["#outline off as given, px", "#rescued, px"] if outlines else []
    rows = [
        [
            name,
            f"{1000 * move:.1f}",
            f"{rescued['turns_deg'][name]:.1f}",
            *(outline_off(outlines[name][key]) for key in ("given", "rescued") if outlines),
        ]
        for name, move in rescued["moves_m"].items()
    ]
    pictures = [
        (folder / "photo.png", "Photograph"),
        (folder / "pictures" / "given.png", "As given, through the same camera"),
        (folder / "pictures" / "after.png", "Rescued, through the same camera"),
        (folder / "pictures" / "rescued.png", _CAPTION),
    ]
    figures = [picture(path, caption) for path, caption in pictures] if outlines else []
    return elements.section(
        TITLE,
        elements.paragraph(CHECKED),
        elements.div("pictures", *figures) if figures else "",
        elements.paragraph(_agreement(outlines)),
        elements.table(heads, rows),
        elements.paragraph(OUTLINE_OFF, "dim") if outlines else "",
    )


def _agreement(outlines: dict[str, Any]) -> str:
    """Return a sentence on how many outlines are nearer to the photograph's than as given."""
    if not outlines:
        return "No photograph was given, so nothing was compared with one."
    outline_pairs = [
        (o["given"], o["rescued"]) for o in outlines.values() if None not in o.values()
    ]
    nearer = sum(after < before for before, after in outline_pairs)
    unknown = len(outlines) - len(outline_pairs)
    return (
        f"Of {len(outlines)} movable objects, {nearer} have outlines nearer to the photograph's "
        f"than as given, {len(outline_pairs) - nearer} do not, and {unknown} are unknown."
    )

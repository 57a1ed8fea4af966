"""Table of joints and surfaces, alongside the paper's."""

from collections.abc import Sequence
from typing import Any

from neoworld_mjx.io.text_tables import TextTable

from ..objects.object_scores import ObjectScoreRow, score_figures
from ..paper_figures import PAPER_JOINTS, PAPER_SURFACES

PAPER = {name: PAPER_JOINTS[name] | PAPER_SURFACES[name] for name in PAPER_JOINTS}
NOTE = (
    "Rows marked * are the paper's figures: of 245 joints of its own choice, a hit decided by a "
    "model that is shown paired videos, and surfaces normalised as it does not say. Ours "
    "are decided by geometry: another measure."
)
COLUMNS: dict[str, tuple[str, float, int]] = {
    "#Total": ("total", 1.0, 0),
    "#Pred": ("predicted", 1.0, 0),
    "#Hit": ("hits", 1.0, 0),
    "correct": ("correct", 1.0, 0),
    "Miss %": ("miss", 100.0, 2),
    "Type %": ("type_error", 100.0, 2),
    "Axis deg [n]": ("axis_deg", 1.0, 2),
    "Pivot [n]": ("pivot", 1.0, 3),
    "CD x10 [n]": ("chamfer_x10", 1.0, 4),
    "F@0.01 [n]": ("f_01", 1.0, 2),
    "F@0.05 [n]": ("f_05", 1.0, 2),
}
"""Column by figure, factor and digits."""


def joint_table(rows: Sequence[ObjectScoreRow]) -> TextTable:
    """Return a row for each object, one for all, and those of the paper."""
    lines = [_cells(row.object, score_figures([row])) for row in rows]
    lines.append(_cells(f"all {len(rows)} objects", score_figures(rows)))
    lines += [_cells(f"{name}*", figures) for name, figures in PAPER.items()]
    return TextTable(NOTE, ["object or method", *COLUMNS], lines)


def _cells(name: str, figures: dict[str, Any]) -> list[str]:
    return [name, *(_cell(figures.get(figure), k, n) for figure, k, n in COLUMNS.values())]


def _cell(value: Any, factor: float, digits: int) -> str:
    if isinstance(value, dict):
        return "" if value["value"] is None else f"{value['value']:.{digits}f} [{value['n']}]"
    return "" if value is None else f"{factor * value:.{digits}f}"

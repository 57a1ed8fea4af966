"""Scene table of the paper with our results, in Markdown, CSV and LaTeX."""

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from neoworld_mjx.sweeps.intervals import LEVEL

from ..methods.scene_objects import read_object_rows
from ..methods.scene_runs import SceneRow, known_rows
from .scene_curves import curve_records, curves_csv, curves_svg
from .scene_summary import interval

COLUMNS = {
    "valid": ("valid_rate", 100.0, "%"),
    "displaced": ("displaced", 100.0, "%"),
    "missed": ("missed", 100.0, "%"),
    "extra": ("extra", 100.0, "%"),
    "S-Pen": ("s_pen", 100.0, "%"),
    "P-Pen": ("p_pen", 100.0, "%"),
    "S-Stab": ("s_stab", 100.0, "%"),
    "O-Stab": ("o_stab", 100.0, "%"),
    "position": ("xy_error_m", 1000.0, "mm"),
    "heading": ("yaw_error_deg", 1.0, "deg"),
    "log scale": ("scale_error", 100.0, "%"),
    "box IoU": ("box_iou", 1.0, ""),
}
"""Column by measure, factor and unit."""
PAPER: dict[str, dict[str, dict[str, float]]] = {
    "full": {
        "VIGA": {"S-Pen": 56.67, "P-Pen": 63.37, "S-Stab": 23.33, "O-Stab": 27.33},
        "SAGE": {"S-Pen": 6.67, "P-Pen": 2.41, "S-Stab": 70.0, "O-Stab": 91.6},
        "NeoWorld-Pro": {"S-Pen": 0.0, "P-Pen": 0.0, "S-Stab": 100.0, "O-Stab": 100.0},
    },
    "tabletop": {
        "VIGA": {"S-Pen": 54.55, "P-Pen": 67.26, "S-Stab": 18.18, "O-Stab": 25.66},
        "TabletopGen": {"S-Pen": 45.45, "P-Pen": 26.53, "S-Stab": 36.36, "O-Stab": 67.35},
        "SAGE": {"S-Pen": 9.09, "P-Pen": 4.17, "S-Stab": 100.0, "O-Stab": 100.0},
        "NeoWorld-Pro": {"S-Pen": 0.0, "P-Pen": 0.0, "S-Stab": 100.0, "O-Stab": 100.0},
    },
}
"""Scene-level table of the paper, on the paper's own scenes; n is 30 and 11 scenes."""
THRESHOLDS = (
    "S-Pen over 1 mm; P-Pen: of articulated objects [n], two parts over 1 mm anywhere in the "
    "joints' ranges; S-Stab and O-Stab under 1 cm and 5 deg in 2 s of free fall; "
    "valid: all of it, and no object toppled or fallen"
)
_NAMES = {"full": "All scenes", "tabletop": "Tabletop", "evaluation": "Evaluation half"}


def scene_tables(folder: Path) -> dict[str, str]:
    """Return table.md, table.csv and table.tex of a folder's rows, curves.csv and curves.svg.

    Raises:
        RunError: the rows cannot be read.
    """
    records = list(table_records(known_rows(folder)))
    texts = {
        "table.md": markdown(records),
        "table.csv": comma_separated(records),
        "table.tex": latex(records),
    }
    if curves := curve_records(read_object_rows(folder)):
        texts["curves.csv"] = curves_csv(curves)
        if (svg := curves_svg(curves)) is not None:
            texts["curves.svg"] = svg
    return texts


def table_records(rows: Sequence[SceneRow]) -> Iterator[dict[str, Any]]:
    """Yield a record for each subset and method: ours with intervals, the paper's without."""
    subsets = {
        "full": list(rows),
        "tabletop": [row for row in rows if row.tabletop],
        "evaluation": [row for row in rows if row.evaluation],
    }
    for subset, subset_rows in subsets.items():
        for method in dict.fromkeys(row.method for row in subset_rows):
            method_rows = [row for row in subset_rows if row.method == method]
            record: dict[str, Any] = {"subset": subset, "method": method, "source": "measured"}
            record |= {"n": len(method_rows), "scenes": len({row.scene for row in method_rows})}
            record["articulated"] = sum(row.articulated for row in method_rows)
            for column, (measure, factor, _) in COLUMNS.items():
                for end, value in zip(
                    ("", " low", " high"), interval(method_rows, measure), strict=True
                ):
                    if value is not None:
                        record[column + end] = factor * value
            yield record
        for method, values in PAPER.get(subset, {}).items():
            count = 30 if subset == "full" else 11
            yield {
                "subset": subset,
                "method": method,
                "source": "paper",
                "n": count,
                "scenes": count,
                **values,
            }


def markdown(records: Sequence[dict[str, Any]]) -> str:
    """Return the table as Markdown, with a section for each subset."""
    head = ["method", "n", *(f"{name} [{u}]" if u else name for name, (_, _, u) in COLUMNS.items())]
    lines = [
        f"{THRESHOLDS}. Means with {LEVEL:.0%} intervals, clustered by scene. "
        "Rows marked * are the paper's figures, on its own scenes and from photographs.",
    ]
    for subset in dict.fromkeys(record["subset"] for record in records):
        lines += ["", f"### {_NAMES[subset]}", "", "| " + " | ".join(head) + " |"]
        lines.append("|" + "---|" * len(head))
        for record in (r for r in records if r["subset"] == subset):
            star = "*" if record["source"] == "paper" else ""
            cells = [record["method"] + star, str(record["n"])]
            cells += [_cell(record, column) for column in COLUMNS]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def comma_separated(records: Sequence[dict[str, Any]]) -> str:
    """Return the table as CSV, with columns for the ends of intervals."""
    names = ["subset", "method", "source", "n", "scenes", "articulated"]
    for column in COLUMNS:
        names += [column, f"{column} low", f"{column} high"]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return stream.getvalue()


def latex(records: Sequence[dict[str, Any]]) -> str:
    """Return the table as LaTeX, for the package booktabs."""
    lines = [rf"% {THRESHOLDS}", rf"\begin{{tabular}}{{lr{'c' * len(COLUMNS)}}}", r"\toprule"]
    lines.append(" & ".join(["Method", "n", *COLUMNS]) + r" \\")
    for subset in dict.fromkeys(record["subset"] for record in records):
        width = 2 + len(COLUMNS)
        lines += [r"\midrule", rf"\multicolumn{{{width}}}{{c}}{{\textit{{{_NAMES[subset]}}}}} \\"]
        for record in (r for r in records if r["subset"] == subset):
            star = r"$^\ast$" if record["source"] == "paper" else ""
            cells = [record["method"].replace("_", r"\_") + star, str(record["n"])]
            cells += [_cell(record, column, latex=True) for column in COLUMNS]
            lines.append(" & ".join(cells) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}", r"% $\ast$: figures of the paper"]
    return "\n".join(lines) + "\n"


def _cell(record: dict[str, Any], column: str, *, latex: bool = False) -> str:
    if column not in record:
        return "--" if latex else ""
    digits = 3 if column == "box IoU" else 1
    value = f"{record[column]:.{digits}f}"
    if record["source"] == "paper":
        return f"{record[column]:.2f}"
    over = f" [{record['articulated']}]" if column == "P-Pen" else ""
    if f"{column} low" not in record:
        return value + over
    low, high = record[f"{column} low"], record[f"{column} high"]
    return f"{value} ({low:.{digits}f} to {high:.{digits}f}){over}"

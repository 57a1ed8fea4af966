"""Table of reconstructions of real photographs: an object each, and all of a method."""

from collections.abc import Sequence

import numpy as np

from neoworld_mjx.io.text_tables import TextTable

from ..measures.pose_measure import RECALL, recall
from ..real_poses.pose_rows import RealObjectRow

NOTE = (
    "Errors in mm are medians over an object's pixels, after one similarity of the whole scene. "
    "Bias is positive where the object is too far. ADD-S (over the diameter), ICP rotation and 3D "
    "IoU are the layout measures of SAM 3D. Chamfer distance, F-score at 0.1 and voxel IoU at 1/32 "
    "are in the frame in which the true object fits [-1, 1]^3."
)
COLUMNS: dict[str, tuple[str, int]] = {
    "error mm": ("error_mm", 1),
    "depth mm": ("depth_error_mm", 1),
    "bias mm": ("bias_mm", 1),
    "ADD-S": ("add_s", 3),
    "ICP deg": ("icp_rot_deg", 1),
    "3D IoU": ("box_iou", 3),
    "CD": ("chamfer", 3),
    "F@0.1": ("f_score", 3),
    "voxel IoU": ("voxel_iou", 3),
    "position mm": ("position_mm", 1),
    "collider out mm": ("collider_protruding_mm", 1),
    "collider short mm": ("collider_short_mm", 1),
}
"""Column by figure and digits; columns without a value are left out."""


def real_table(rows: Sequence[RealObjectRow]) -> TextTable:
    """Return a row for each object, and medians with the recall for each method and stage."""
    columns = {
        column: (figure, digits)
        for column, (figure, digits) in COLUMNS.items()
        if any(getattr(row, figure) is not None for row in rows)
    }
    posed = any(row.true_object for row in rows)
    heads = ["view", "method", "stage", "object", "pixels", *columns]
    lines = []
    for row in rows:
        name = row.object or f"{row.true_object} (missed)"
        cells = [_cell(getattr(row, figure), digits) for figure, digits in columns.values()]
        lines.append([row.view, row.method, row.stage, name, str(row.visible_px), *cells])
    for method, stage in dict.fromkeys((row.method, row.stage) for row in rows):
        group = [row for row in rows if (row.method, row.stage) == (method, stage)]
        cells = [_median(group, figure, digits) for figure, digits in columns.values()]
        lines.append(["median", method, stage, f"{len(group)} rows", "", *cells])
    if posed:
        heads.append(f"ADD-S < {RECALL:g}")
        for line, row in zip(lines, rows, strict=False):
            correct = row.add_s is not None and row.add_s < RECALL
            line.append(("yes" if correct else "no") if row.true_object else "")
        for line in lines[len(rows) :]:
            errors = [
                row.add_s
                for row in rows
                if (row.method, row.stage) == (line[1], line[2]) and row.true_object
            ]
            share = recall(errors)
            line.append("" if share is None else f"{100 * share:.0f} % [{len(errors)}]")
    return TextTable(NOTE, heads, lines)


def _cell(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _median(rows: Sequence[RealObjectRow], figure: str, digits: int) -> str:
    values = [value for row in rows if (value := getattr(row, figure)) is not None]
    return f"{float(np.median(values)):.{digits}f} [{len(values)}]" if values else ""

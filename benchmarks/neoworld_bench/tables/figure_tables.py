"""Tables of results as text, with sizes: `table` and `n` of what a suite prints.

Intervals are clustered by scene or task.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from neoworld_mjx.sweeps.intervals import Interval

from ..methods.scene_runs import SceneRow
from ..tasks.success_runs import SuccessRow
from ..tasks.success_summary import SHARES, success_interval
from .scene_summary import figures, interval

Table = dict[str, Any]
"""`n`, sizes in words, and `table`, a list of rows: text by column."""
SCENE_COLUMNS: dict[str, str] = {
    "final check passed": "check_rate",
    "objects displaced": "displaced",
    "S-Pen": "s_pen",
    "P-Pen": "p_pen",
    "S-Stab": "s_stab",
    "O-Stab": "o_stab",
}
"""Shares of `scene_summary.MEASURES` by column."""
TASK_COLUMNS = ("task success", "in the layout", "unaligned", "valid")
"""Columns of `success_summary.SHARES`."""


def scene_figure_table(rows: Sequence[SceneRow], methods: Sequence[str]) -> Table:
    """Return a row for each of these methods, in their order."""
    table = []
    for method, method_rows in _by_method(rows, methods).items():
        half = [row for row in method_rows if row.evaluation]
        seconds = figures(method_rows)["seconds"]
        table.append(
            {
                "method": method,
                "valid": _share(interval(method_rows, "valid_rate")),
                "of the evaluation half": _share(interval(half, "valid_rate")),
                **{
                    name: _share(interval(method_rows, measure))
                    for name, measure in SCENE_COLUMNS.items()
                },
                "position": _mean(interval(method_rows, "xy_error_m"), 1e3, 1, " mm"),
                "heading": _mean(interval(method_rows, "yaw_error_deg"), 1.0, 1, "°"),
                "log scale": _mean(interval(method_rows, "scale_error"), 100.0, 1, " %"),
                "edges": _mean(interval(method_rows, "edge_error"), 100.0, 1, " %"),
                "box IoU": _mean(interval(method_rows, "box_iou"), 1.0, 3, ""),
                "whole": "" if seconds is None else f"{seconds:.2g} s",
            }
        )
    first = next(iter(_by_method(rows, methods).values()), [])
    n = (
        f"{len(first)} initial scenes of {len({row.scene for row in first})} scenes, "
        f"{sum(row.evaluation for row in first)} of them of the evaluation half; "
        f"{sum(row.objects for row in first)} movable objects, of which "
        f"{sum(row.missed for row in first)} are missed, and {sum(row.extra for row in first)} "
        "invented ones"
    )
    return {"n": n, "table": table}


def task_figure_table(rows: Sequence[SuccessRow], methods: Sequence[str]) -> Table:
    """Return a row for each of these methods, in their order."""
    table = []
    for method, method_rows in _by_method(rows, methods).items():
        times = [row.seconds for row in method_rows]
        cells = [_share(success_interval(method_rows, share)) for share in SHARES]
        table.append(
            {
                "method": method,
                **dict(zip(TASK_COLUMNS, cells, strict=True)),
                "seconds of the method, median and largest": (
                    f"{np.median(times):.2g} and {max(times):.2g}"
                ),
            }
        )
    first = next(iter(_by_method(rows, methods).values()), [])
    half = sum(row.evaluation for row in first)
    n = f"{len({row.task for row in first})} tasks, {len(first)} initial scenes, "
    return {"n": f"{n}{half} of them of the evaluation half", "table": table}


def _by_method(rows: Sequence[Any], methods: Sequence[str]) -> dict[str, list[Any]]:
    names = dict.fromkeys([*methods, *(row.method for row in rows)])
    by_method = {name: [row for row in rows if row.method == name] for name in names}
    return {name: method_rows for name, method_rows in by_method.items() if method_rows}


def _share(estimate: Interval) -> str:
    """Return a share and its interval in per cent, with a decimal below 10 %."""
    value, low, high = estimate
    if value is None:
        return ""
    digits = 0 if value >= 0.095 or value == 0 else 1
    text = f"{100 * value:.{digits}f} %"
    if low is None or high is None:
        return text
    return f"{text} ({100 * low:.{digits}f} to {100 * high:.{digits}f})"


def _mean(estimate: Interval, factor: float, digits: int, unit: str) -> str:
    """Return a mean and its interval."""
    value, low, high = estimate
    if value is None:
        return ""
    text = f"{factor * value:.{digits}f}{unit}"
    if low is None or high is None:
        return text
    return f"{text} ({factor * low:.{digits}f} to {factor * high:.{digits}f})"

"""Tables of results as text, with sizes: `table` and `n` of what a suite prints.

`python -m benchmarks.page --record` makes the tables of the documentation from them, so their
columns are those that readers see. Intervals are clustered by scene, task, photograph or object.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from neoworld_mjx.sweeps.intervals import Interval, ratio_interval

from ..methods.scene_runs import SceneRow
from ..objects.object_scores import ObjectScoreRow, score_figures
from ..real_poses.pose_rows import RealObjectRow, RealViewRow
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
NEAR_MM = 10.0
"""Distance below which an object of a real photograph counts as near."""


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


def real_figure_table(views: Sequence[RealViewRow], objects: Sequence[RealObjectRow]) -> Table:
    """Return a row for each object of each photograph, a column for each stage, and for all objects
    of a method's stage the median and the share within NEAR_MM, clustered by photograph."""
    stages = list(dict.fromkeys((row.method, row.stage) for row in views))
    methods = {method for method, _ in stages}
    title = lambda stage: stage[1] if len(methods) == 1 else " ".join(stage)
    table = []
    for view in dict.fromkeys(row.view for row in views):
        fits = {(row.method, row.stage): row for row in views if row.view == view}
        table.append(
            {
                "photograph": view,
                "object": "all: scale, rotation, pixels within 1.5 %",
                "pixels": "",
            }
            | {title(stage): _fit(fits.get(stage)) for stage in stages}
        )
        view_rows = [row for row in objects if row.view == view and row.object]
        for name in dict.fromkeys(row.object for row in view_rows):
            rows_by_stage = {
                (row.method, row.stage): row for row in view_rows if row.object == name
            }
            pixels = dict.fromkeys(str(row.measured_px) for row in rows_by_stage.values())
            table.append(
                {"photograph": "", "object": name, "pixels": " to ".join(pixels)}
                | {title(stage): _distance(rows_by_stage.get(stage)) for stage in stages}
            )
    errors = {
        stage: [
            (row.view, row.error_mm)
            for row in objects
            if (row.method, row.stage) == stage and row.error_mm is not None
        ]
        for stage in stages
    }
    count = len({row.view for row in views})
    every = {"photograph": f"{count} photographs", "object": "median of all objects", "pixels": ""}
    near = every | {"object": f"objects within {NEAR_MM:g} mm"}
    for stage, view_rows in errors.items():
        every[title(stage)] = (
            f"{np.median([error for _, error in view_rows]):.1f}" if view_rows else ""
        )
        parts = [(view, float(error < NEAR_MM), 1.0) for view, error in view_rows]
        near[title(stage)] = _share(ratio_interval(parts, share=True))
    shown = len({(row.view, row.object) for row in objects if row.object})
    return {"n": f"{count} photographs, {shown} objects", "table": [*table, every, near]}


def joint_figure_table(rows: Sequence[ObjectScoreRow]) -> Table:
    """Return a row for each object and one for all, with intervals over objects."""
    table = [_joint_cells(row.object, [row]) for row in rows]
    table.append(_joint_cells("all", rows))
    n = f"{len(rows)} objects, {sum(row.total for row in rows)} joints; in parentheses intervals, "
    return {"n": f"{n}or the number of joints that a mean is taken over", "table": table}


def _joint_cells(name: str, rows: Sequence[ObjectScoreRow]) -> dict[str, str]:
    scores = score_figures(rows)

    def share(count: Callable[[ObjectScoreRow], int]) -> str:
        return _share(
            ratio_interval([(row.object, count(row), row.total) for row in rows], share=True)
        )

    def mean(key: str, digits: int, *, counted: bool = False) -> str:
        value, n = scores[key]["value"], scores[key]["n"]
        return "" if value is None else f"{value:.{digits}f}" + (f" ({n})" if counted else "")

    return {
        "object": name,
        "true": str(scores["total"]),
        "made": str(scores["predicted"]),
        "hits": str(scores["hits"]),
        "extra": str(scores["predicted"] - scores["hits"]),
        "miss": share(lambda row: row.total - row.hits),
        "wrong type": share(lambda row: row.total - row.hits + row.wrong_type),
        "axis°": mean("axis_deg", 2, counted=True),
        "pivot": mean("pivot", 3, counted=True),
        "limits": mean("limits", 2, counted=True),
        "CD ×10": mean("chamfer_x10", 3),
        "F .01": mean("f_01", 1),
        "F .05": mean("f_05", 1),
        "CD ×10 raw": mean("raw_chamfer_x10", 3),
        "F .05 raw": mean("raw_f_05", 1),
        "scale": mean("scale", 2),
    }


def _by_method(rows: Sequence[Any], methods: Sequence[str]) -> dict[str, list[Any]]:
    names = dict.fromkeys([*methods, *(row.method for row in rows)])
    by_method = {name: [row for row in rows if row.method == name] for name in names}
    return {name: method_rows for name, method_rows in by_method.items() if method_rows}


def _fit(row: RealViewRow | None) -> str:
    if row is None:
        return ""
    inliers = "" if row.inliers is None else f", {100 * row.inliers:.0f} %"
    return f"{row.scale:.3f}, {row.rotation_deg:.1f}°{inliers}"


def _distance(row: RealObjectRow | None) -> str:
    if row is None or row.error_mm is None:
        return ""
    bias = "" if row.bias_mm is None else f" ({row.bias_mm:+.1f})"
    return f"{row.error_mm:.1f}{bias}"


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

"""Stability and penetration as functions of their thresholds."""

import csv
import io
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from neoworld_mjx.render.plots import plot_svg
from neoworld_mjx.sweeps.intervals import ratio_interval

from ..methods.scene_objects import ObjectRow


class Curve(NamedTuple):
    """A measure as a function of its threshold."""

    measure: str
    over: str
    thresholds: tuple[float, ...]
    """Thresholds in ascending order, including the table's [m or deg]."""
    table: float
    """Threshold of the table, and of the paper where it states one."""
    factor: float
    unit: str


def _steps(low: float, high: float) -> tuple[float, ...]:
    """Return ten thresholds a decade from low to high, with two significant digits."""
    count = round(10 * np.log10(high / low))
    return tuple(float(f"{low * 10 ** (k / 10):.2g}") for k in range(count + 1))


DRIFT_M, TILT_DEG, DEPTH_M = 0.01, 5.0, 1e-3
"""Thresholds of the tables: S-Stab and O-Stab under these, S-Pen and P-Pen over the last."""
CURVES = (
    Curve("S-Stab", "drift_m", _steps(1e-3, 0.1), DRIFT_M, 1e3, "mm"),
    Curve("O-Stab", "drift_m", _steps(1e-3, 0.1), DRIFT_M, 1e3, "mm"),
    Curve("S-Stab", "tilt_deg", _steps(0.5, 50.0), TILT_DEG, 1.0, "deg"),
    Curve("O-Stab", "tilt_deg", _steps(0.5, 50.0), TILT_DEG, 1.0, "deg"),
    Curve("S-Pen", "depth_m", _steps(1e-4, 0.01), DEPTH_M, 1e3, "mm"),
    Curve("P-Pen", "depth_m", _steps(1e-4, 0.01), DEPTH_M, 1e3, "mm"),
)
FIELDS: tuple[str, ...] = ("method", "measure", "over", "threshold", "share", "low", "high", "n")


def curve_records(objects: Sequence[ObjectRow]) -> list[dict[str, Any]]:
    """Return one record for each method, curve and threshold, with an interval.

    S-Stab counts scenes and O-Stab movable objects that stay under one threshold and under the
    table's other one; S-Pen counts scenes with two objects over the threshold, P-Pen articulated
    objects with two parts over it. "n" is their number; intervals are over scenes.

    Args:
        objects: rows of any methods.
    """
    records = []
    for method in dict.fromkeys(row.method for row in objects):
        method_rows = [row for row in objects if row.method == method]
        for curve in CURVES:
            for threshold in curve.thresholds:
                parts = _parts(method_rows, curve, threshold)
                if not parts:
                    continue
                share, low, high = ratio_interval(parts, share=True)
                values = (method, curve.measure, curve.over, threshold, share, low, high)
                n = round(sum(count for _, _, count in parts))
                records.append(dict(zip(FIELDS, (*values, n), strict=True)))
    return records


def _parts(
    objects: Sequence[ObjectRow], curve: Curve, threshold: float
) -> list[tuple[str, float, float]]:
    """Return scene, 0 or 1, and 1 for everything that a curve counts at a threshold."""
    if curve.measure == "P-Pen":
        depths = [(row.scene, row.part_depth_m) for row in objects]
        return [(scene, float(d > threshold), 1.0) for scene, d in depths if d is not None]
    if curve.measure == "S-Pen":
        flags = [(row, row.depth_m > threshold) for row in objects]
    else:
        drift = threshold if curve.over == "drift_m" else DRIFT_M
        tilt = threshold if curve.over == "tilt_deg" else TILT_DEG
        flags = [
            (row, row.drift_m < drift and row.tilt_deg < tilt)
            for row in objects
            if row.drift_m is not None and row.tilt_deg is not None
        ]
    if curve.measure == "O-Stab":
        return [(row.scene, float(value), 1.0) for row, value in flags]
    scenes: dict[tuple, list[bool]] = {}
    for row, value in flags:
        scenes.setdefault(row.key, []).append(value)
    combine = any if curve.measure == "S-Pen" else all
    return [(key[0], float(combine(values)), 1.0) for key, values in scenes.items()]


def curves_csv(records: Sequence[dict[str, Any]]) -> str:
    """Return curves as CSV, shares from 0 to 1, thresholds in m or deg."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, FIELDS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return stream.getvalue()


def curves_svg(records: Sequence[dict[str, Any]]) -> str | None:
    """Return curves as SVG, a line for each method and a dotted line at the table's threshold.

    Returns:
        The file's text; None, with a line in the log, without matplotlib.
    """
    methods = list(dict.fromkeys(record["method"] for record in records))

    def draw(figure: Any) -> None:
        all_axes = figure.subplots(2, 3).T.ravel()
        for axes, curve in zip(all_axes, CURVES, strict=True):
            _draw(axes, curve, records, methods)
        if methods:
            lines, names = all_axes[0].get_legend_handles_labels()
            figure.legend(lines, names, loc="outside right upper", fontsize=7)

    return plot_svg((10.5, 5.2), draw)


def _draw(axes: Any, curve: Curve, records: Sequence[dict], methods: Sequence[str]) -> None:
    for k, method in enumerate(methods):
        points = [
            (r["threshold"] * curve.factor, 100 * r["share"])
            for r in records
            if (r["method"], r["measure"], r["over"]) == (method, curve.measure, curve.over)
        ]
        if points:
            style = "-" if k < 10 else "--"  # matplotlib's colours come again after ten.
            axes.plot(*zip(*points, strict=True), style, linewidth=1.3, label=method)
    axes.axvline(curve.table * curve.factor, color="0.5", linestyle=":", linewidth=1)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_ylim(-3, 103)
    quantity = curve.over.split("_")[0]
    axes.set(xlabel=f"{quantity} [{curve.unit}]", ylabel=f"{curve.measure} [%]")

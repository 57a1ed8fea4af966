"""Critical-difference diagram of an ablation (Demšar, JMLR 7, 2006)."""

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy import stats

from ..render.plots import plot
from .run_rows import Row

RANKED = (("xy_error_m", "xy error"), ("d_drift", "D_drift"))
"""Columns that points may be ranked by, the smallest value first: the first one that all runs have.
Neither depends on the weights of the reward, which variants may change."""
LEVEL = 0.05


class Ranks(NamedTuple):
    """Mean ranks of points over scenes."""

    points: list[str]
    """From the best to the worst."""
    means: list[float]
    """Mean rank of each point; 1 is the best, ties share their ranks."""
    scenes: int
    critical: float
    """Nemenyi's critical difference: means that are closer do not differ at the 5 % level."""
    friedman_p: float
    """p of Friedman's test that all points rank alike."""
    title: str
    """Column by which the points are ranked."""


def ranks(rows: Sequence[Row], points: Sequence[str]) -> Ranks | None:
    """Rank points in each scene by the mean of a metric over the seeds.

    The metric is the first of `RANKED` for which two scenes have a finite value of every point.

    Args:
        rows: the runs; a scene in which a point lacks runs is left out.
        points: the points to rank.

    Returns:
        None for fewer than three points, or without such a metric.
    """
    for name, title in RANKED:
        cells: dict[str, dict[str, list[float]]] = {}
        for row in rows:
            value = row.get(name)
            if value is not None and math.isfinite(value):
                cells.setdefault(row["scene"], {}).setdefault(row["point"], []).append(value)
        whole = [scene for scene in cells.values() if all(point in scene for point in points)]
        if len(points) < 3 or len(whole) < 2:
            continue
        values = np.array([[np.mean(scene[point]) for point in points] for scene in whole])
        means = stats.rankdata(values, axis=1).mean(axis=0)
        count, number = len(points), len(whole)
        quantile = stats.studentized_range.ppf(1 - LEVEL, count, np.inf) / math.sqrt(2)
        critical = float(quantile) * math.sqrt(count * (count + 1) / (6 * number))
        tied = bool((values == values[:, :1]).all())
        p = 1.0 if tied else float(stats.friedmanchisquare(*values.T).pvalue)
        order = np.argsort(means, kind="stable")
        ordered = [str(points[k]) for k in order]
        return Ranks(ordered, [float(means[k]) for k in order], number, critical, p, title)
    return None


def cliques(found: Ranks) -> list[tuple[int, int]]:
    """Return the first and last index of each largest group of points that do not differ."""
    groups: list[tuple[int, int]] = []
    for first, low in enumerate(found.means):
        last = max(k for k, mean in enumerate(found.means) if mean - low <= found.critical)
        if last > first and (not groups or last > groups[-1][1]):
            groups.append((first, last))
    return groups


def draw_ranks(found: Ranks, form: Literal["svg", "pdf"]) -> bytes | None:
    """Draw mean ranks on an axis, and bars over the points that do not differ."""

    def fill(figure: Any) -> None:
        axes = figure.subplots()
        bars = cliques(found)
        for k, (first, last) in enumerate(bars):
            axes.plot(
                [found.means[first] - 0.03, found.means[last] + 0.03], [-0.4 - 0.3 * k] * 2, "k",
                linewidth=3,
            )  # fmt: skip
        top = -0.4 - 0.3 * len(bars)
        for k, (point, mean) in enumerate(zip(found.points, found.means, strict=True)):
            height = top - 0.5 * (k + 1)
            axes.plot([mean, mean], [0, height], color="0.6", linewidth=0.7)
            axes.text(mean, height, f" {point} ({mean:.2f})", fontsize=7, va="center")
        axes.plot([1, 1 + found.critical], [0.6, 0.6], "k", linewidth=1.5)
        axes.text(1, 0.8, f"critical difference {found.critical:.2f}", fontsize=7)
        axes.set(
            xlim=(0.9, len(found.points) + 1.5), ylim=(top - 0.5 * len(found.points) - 0.6, 1.3)
        )
        axes.xaxis.tick_top()
        axes.yaxis.set_visible(False)
        for side in ("left", "right", "bottom"):
            axes.spines[side].set_visible(False)
        axes.set_title(
            f"mean rank by {found.title} over {found.scenes} scenes; Friedman p "
            f"{found.friedman_p:.2g}", fontsize=8,
        )  # fmt: skip

    return plot((6.4, 1.6 + 0.17 * len(found.points)), fill, form)

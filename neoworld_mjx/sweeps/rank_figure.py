"""Critical-difference diagram of an ablation (Demšar, JMLR 7, 2006)."""

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy import stats

from ..render.plots import plot
from .run_rows import Row

RANK_COLUMNS = (("xy_error_m", "xy error"), ("d_drift", "D_drift"))
"""Columns by which points can be ranked, and their titles; the smallest value ranks first.

These columns do not depend on the weights of the reward, which variants may change.
"""
LEVEL = 0.05
"""Significance level of the critical difference."""


class Ranks(NamedTuple):
    """Mean ranks of points over scenes."""

    points: list[str]
    """Labels of the points, best first."""
    means: list[float]
    """Mean rank of each point; 1 is the best. Tied points get the average of their ranks."""
    scenes: int
    """Number of scenes."""
    critical: float
    """Nemenyi's critical difference. Mean ranks that are closer do not differ significantly."""
    friedman_p: float
    """p value of Friedman's test of the hypothesis that all points have equal ranks."""
    title: str
    """Title of the column by which the points are ranked."""


def ranks(rows: Sequence[Row], points: Sequence[str]) -> Ranks | None:
    """Rank points in each scene by the mean of a column over the seeds.

    The column is the first one in `RANK_COLUMNS` for which at least two scenes have finite values
    of every point. Scenes without a finite value of some point are omitted.

    Args:
        rows: the runs.
        points: labels of the points to rank.

    Returns:
        The mean ranks; None if there are fewer than three points, or if there is no such column.
    """
    for name, title in RANK_COLUMNS:
        cells: dict[str, dict[str, list[float]]] = {}
        for row in rows:
            value = row.get(name)
            if value is not None and math.isfinite(value):
                cells.setdefault(row["scene"], {}).setdefault(row["point"], []).append(value)
        complete_scenes = [
            scene for scene in cells.values() if all(point in scene for point in points)
        ]
        if len(points) < 3 or len(complete_scenes) < 2:
            continue
        values = np.array(
            [[np.mean(scene[point]) for point in points] for scene in complete_scenes]
        )
        means = stats.rankdata(values, axis=1).mean(axis=0)
        count, number = len(points), len(complete_scenes)
        quantile = stats.studentized_range.ppf(1 - LEVEL, count, np.inf) / math.sqrt(2)
        critical = float(quantile) * math.sqrt(count * (count + 1) / (6 * number))
        tied = bool((values == values[:, :1]).all())
        p = 1.0 if tied else float(stats.friedmanchisquare(*values.T).pvalue)
        order = np.argsort(means, kind="stable")
        ordered = [str(points[k]) for k in order]
        return Ranks(ordered, [float(means[k]) for k in order], number, critical, p, title)
    return None


def cliques(mean_ranks: Ranks) -> list[tuple[int, int]]:
    """Return the maximal groups of points that do not differ significantly.

    Returns:
        Index of the first and of the last point of each group.
    """
    groups: list[tuple[int, int]] = []
    for first, low in enumerate(mean_ranks.means):
        last = max(
            k for k, mean in enumerate(mean_ranks.means) if mean - low <= mean_ranks.critical
        )
        if last > first and (not groups or last > groups[-1][1]):
            groups.append((first, last))
    return groups


def draw_ranks(mean_ranks: Ranks, file_format: Literal["svg", "pdf"]) -> bytes | None:
    """Draw mean ranks on an axis, and a bar for each group of `cliques`.

    If matplotlib is missing, return None.
    """

    def fill(figure: Any) -> None:
        axes = figure.subplots()
        bars = cliques(mean_ranks)
        for k, (first, last) in enumerate(bars):
            axes.plot(
                [mean_ranks.means[first] - 0.03, mean_ranks.means[last] + 0.03],
                [-0.4 - 0.3 * k] * 2,
                "k",
                linewidth=3,
            )
        top = -0.4 - 0.3 * len(bars)
        for k, (point, mean) in enumerate(zip(mean_ranks.points, mean_ranks.means, strict=True)):
            height = top - 0.5 * (k + 1)
            axes.plot([mean, mean], [0, height], color="0.6", linewidth=0.7)
            axes.text(mean, height, f" {point} ({mean:.2f})", fontsize=7, va="center")
        axes.plot([1, 1 + mean_ranks.critical], [0.6, 0.6], "k", linewidth=1.5)
        axes.text(1, 0.8, f"critical difference {mean_ranks.critical:.2f}", fontsize=7)
        axes.set(
            xlim=(0.9, len(mean_ranks.points) + 1.5),
            ylim=(top - 0.5 * len(mean_ranks.points) - 0.6, 1.3),
        )
        axes.xaxis.tick_top()
        axes.yaxis.set_visible(False)
        for side in ("left", "right", "bottom"):
            axes.spines[side].set_visible(False)
        axes.set_title(
            f"mean rank by {mean_ranks.title} over {mean_ranks.scenes} scenes; Friedman p "
            f"{mean_ranks.friedman_p:.2g}", fontsize=8,
        )  # fmt: skip

    return plot((6.4, 1.6 + 0.17 * len(mean_ranks.points)), fill, file_format)

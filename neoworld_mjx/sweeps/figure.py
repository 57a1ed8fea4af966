"""Figure of a sweep: convergence of the points, and effects of the axes."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..render.plots import plot_svg
from .runs import Row

MAX_LINES = 8
"""Maximum number of points whose convergence is drawn; those of best median reward are chosen."""
EFFECTS = (("passed", "passed, %", 100.0), ("d_drift", "D_drift", 1.0), ("s_sem", "S_sem", 1.0))
"""Column, label and factor of the values whose dependence on the axes is drawn.

Such columns must not depend on the weights of the reward.
"""


def draw(rows: Sequence[Row], axes: Sequence[str]) -> str | None:
    """Draw a sweep as SVG. If matplotlib is missing, log this and return None.

    - Left: the best reward so far as a function of the number of rollouts, as the median and the
      interquartile range over scenes and seeds.
    - Right: means of the columns in EFFECTS as functions of the first axis that has several values,
      with a line for each value of the second such axis, and a dot for each run.

    Args:
        rows: the runs, each with its iterations under "history".
        axes: columns that distinguish points.
    """
    axes = [name for name in axes if len({row[name] for row in rows}) > 1][:2]
    effects = EFFECTS if axes else ()

    def fill(figure: Any) -> None:
        first, *others = figure.subplots(1, 1 + len(effects), squeeze=False)[0]
        _draw_convergence(first, rows)
        for plot, (name, label, factor) in zip(others, effects, strict=True):
            _draw_effect(plot, rows, axes, name, factor)
            plot.set(xlabel=_short(axes[0]), ylabel=label)

    return plot_svg((3.4 * (1 + len(effects)), 3.2), fill)


def _draw_convergence(plot: Any, rows: Sequence[Row]) -> None:
    quartiles: dict[str, np.ndarray] = {}
    counts: dict[str, list[int]] = {}
    for point in dict.fromkeys(row["point"] for row in rows):
        runs = [row["history"] for row in rows if row["point"] == point and row["history"]]
        best = [[math.nan if s["best"] is None else s["best"] for s in steps] for steps in runs]
        length = max(map(len, best), default=0)
        # The last value of a run continues after the run has stopped.
        values = np.array([run + [run[-1]] * (length - len(run)) for run in best])
        if length and np.isfinite(values).any(axis=0).all():
            quartiles[point] = np.nanquantile(values, (0.25, 0.5, 0.75), axis=0)
            # The populations of a point's runs are equal, so the counts of the longest run fit all.
            counts[point] = [step["rollouts"] for step in max(runs, key=len)]
    drawn = sorted(quartiles, key=lambda point: quartiles[point][1, -1], reverse=True)[:MAX_LINES]
    for point in (point for point in quartiles if point in drawn):
        low, median, high = quartiles[point]
        (line,) = plot.plot(counts[point], median, marker=".", label=_short(point))
        plot.fill_between(counts[point], low, high, color=line.get_color(), alpha=0.15, linewidth=0)
    best_of = f" of the best {len(drawn)} of {len(quartiles)}" if quartiles.keys() - drawn else ""
    plot.set(title=f"convergence{best_of}", xlabel="rollouts", ylabel="best reward so far")
    if drawn:
        plot.legend(fontsize=6)


def _draw_effect(
    plot: Any, rows: Sequence[Row], axes: Sequence[str], name: str, factor: float
) -> None:
    levels = [sorted({row[axis] for row in rows}, key=_order) for axis in axes]
    for other in levels[1] if len(axes) > 1 else [None]:
        cells: dict[int, list[float]] = {}
        for row in rows:
            known = row.get(name) is not None and math.isfinite(row[name])
            if known and (len(axes) == 1 or row[axes[1]] == other):
                cells.setdefault(levels[0].index(row[axes[0]]), []).append(factor * row[name])
        x = sorted(cells)
        label = None if len(axes) == 1 else f"{_short(axes[1])} {_short(other)}"
        (line,) = plot.plot(x, [np.mean(cells[k]) for k in x], "o-", label=label)
        dots = [(k, value) for k in x for value in cells[k]]
        plot.plot(*np.array(dots).reshape(-1, 2).T, ".", color=line.get_color(), alpha=0.3)
    plot.set_xticks(range(len(levels[0])), [_short(v) for v in levels[0]])
    if len(axes) > 1:
        plot.legend(fontsize=6)


def _order(value: Any) -> tuple[bool, Any]:
    return isinstance(value, str), value


def _short(value: Any) -> str:
    """Return a short label: the last part of an option's path, or a formatted number."""
    if isinstance(value, float):
        return f"{value:g}"
    text = str(value)
    if text.startswith("refine."):
        text = text.rpartition(".")[2]
    return text if len(text) <= 40 else f"{text[:37]}..."

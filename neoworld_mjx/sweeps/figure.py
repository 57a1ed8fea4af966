"""Figure of a sweep: convergence of the points, effects of the axes, and terms of the winners."""

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from ..render import plots
from .run_rows import Row

MAX_CELLS = 64
"""Maximum number of cells of a heat map that is annotated with values."""
MAX_LINES = 8
"""Maximum number of points whose convergence is drawn; those of best median reward are chosen."""


class Effect(NamedTuple):
    """A column whose dependence on the axes is drawn.

    Such columns must not depend on the weights of the reward.
    """

    name: str
    """Column of the rows."""
    label: str
    factor: float = 1.0
    """Factor from the values of the column to the drawn values."""
    low: float | None = None
    """Lower end of the drawn scale; None fits it to the values."""
    high: float | None = None
    """Upper end of the drawn scale; None fits it to the values."""


EFFECTS = (
    Effect("passed", "passed, %", 100.0, 0.0, 100.0),
    Effect("d_drift", "D_drift", low=0.0),
    Effect("s_sem", "S_sem"),
)


def draw(
    rows: Sequence[Row], axes: Sequence[str], file_format: Literal["svg", "pdf"] = "svg"
) -> bytes | None:
    """Draw a sweep as SVG or PDF. If matplotlib is missing, log this and return None.

    - Left: the best reward so far as a function of the number of rollouts, as the median and the
      interquartile range over scenes and seeds.
    - Middle: the columns in EFFECTS as functions of the axes that have several values. One axis
      gives lines and dots for all runs; of several axes, the first two give heat maps.
    - Right: S_sem against D_drift of every run.

    Args:
        rows: the runs, each with its iterations under "history".
        axes: columns that distinguish points.
        file_format: format of the file.
    """
    axes = [name for name in axes if len({row[name] for row in rows}) > 1][:2]
    effects = EFFECTS if axes else ()

    def fill(figure: Any) -> None:
        first, *middle, last = figure.subplots(1, 2 + len(effects))
        _convergence(first, rows)
        for plot, effect in zip(middle, effects, strict=True):
            _effect(figure, plot, rows, axes, effect)
        _terms(last, rows)

    return plots.plot((3.4 * (2 + len(effects)), 3.2), fill, file_format)


def _convergence(plot: Any, rows: Sequence[Row]) -> None:
    curves, rollouts = defaultdict(list), defaultdict(list)
    for row in rows:
        steps = row.get("history", ())
        curves[row["point"]].append([np.nan if s["best"] is None else s["best"] for s in steps])
        rollouts[row["point"]].append([s["rollouts"] for s in steps])
    quartiles = {}
    for point, runs in curves.items():
        length = max(map(len, runs))
        # The last value of a run continues after the run has stopped.
        best = np.array([run + [run[-1] if run else np.nan] * (length - len(run)) for run in runs])
        if np.isfinite(best).any():
            known = [column[np.isfinite(column)] for column in best.T]
            quartiles[point] = np.array(
                [np.quantile(c, (0.25, 0.5, 0.75)) if len(c) else [np.nan] * 3 for c in known]
            ).T
    ranked = sorted(quartiles, key=lambda point: quartiles[point][1, -1], reverse=True)
    drawn_points = ranked[:MAX_LINES]
    for point in (point for point in quartiles if point in drawn_points):
        low, median, high = quartiles[point]
        # The populations of a point's runs are equal, so the counts of the longest run fit all.
        counts = max(rollouts[point], key=len)
        (line,) = plot.plot(counts, median, marker=".", label=_short(point))
        plot.fill_between(counts, low, high, color=line.get_color(), alpha=0.15, linewidth=0)
    best_of = (
        f" of the best {len(drawn_points)} of {len(ranked)}"
        if len(drawn_points) < len(ranked)
        else ""
    )
    plot.set(title=f"convergence{best_of}", xlabel="rollouts", ylabel="best reward so far")
    plot.xaxis.get_major_locator().set_params(integer=True)
    if drawn_points:
        plot.legend(fontsize=6)


def _effect(
    figure: Any, plot: Any, rows: Sequence[Row], axes: Sequence[str], effect: Effect
) -> None:
    name, label, factor, low, high = effect
    levels = [sorted({row[axis] for row in rows}, key=_order) for axis in axes]
    cells = defaultdict(list)
    for row in rows:
        if row.get(name) is not None and math.isfinite(row[name]):
            cell = tuple(level.index(row[axis]) for axis, level in zip(axes, levels, strict=True))
            cells[cell].append(factor * float(row[name]))
    means = np.full([len(level) for level in levels], np.nan)
    for cell, values in cells.items():
        means[cell] = np.mean(values)
    if len(axes) == 1:
        points = [(x, value) for (x,), values in cells.items() for value in values]
        if points:
            plot.plot(*zip(*points, strict=True), ".", color="0.7")
        plot.plot(range(len(means)), means, "o-", label="mean")
        if low is not None:
            margin = 0.05 * ((high or plot.get_ylim()[1]) - low)
            plot.set_ylim(low - margin, None if high is None else high + margin)
    else:
        image = plot.imshow(means, origin="lower", aspect="auto", vmin=low, vmax=high)
        figure.colorbar(image, ax=plot)
        plot.set_yticks(range(len(levels[0])), [_short(v) for v in levels[0]])
        if means.size <= MAX_CELLS:
            middle = np.mean(image.get_clim())
            for (y, x), mean in np.ndenumerate(means):
                color = "black" if mean > middle else "white"
                plot.text(x, y, f"{mean:.3g}", ha="center", va="center", color=color)
    plot.set_xticks(range(len(levels[-1])), [_short(v) for v in levels[-1]])
    plot.set(title=label, xlabel=_short(axes[-1]))
    plot.set_ylabel(label if len(axes) == 1 else _short(axes[0]))


def _terms(plot: Any, rows: Sequence[Row]) -> None:
    for passed, marker, color in ((True, "o", "C2"), (False, "x", "C3")):
        points = [
            (row["d_drift"], row["s_sem"])
            for row in rows
            if bool(row["passed"]) is passed and None not in (row["d_drift"], row["s_sem"])
        ]
        if points:
            label = "passed" if passed else "not passed"
            plot.scatter(*zip(*points, strict=True), s=14, marker=marker, c=color, label=label)
    plot.set(xlabel="D_drift", ylabel="S_sem", title="terms of the winners")
    if plot.collections:
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

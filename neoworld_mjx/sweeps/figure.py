"""One figure of a sweep: convergence of its points, the effect of its axes, terms side by side."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..render.plots import plot_svg
from .run_rows import Row

MOST_CELLS = 64
"""Combinations of values that a heat map writes as numbers."""
MOST_LINES = 8
"""Points whose convergence is drawn; of more, the best by median reward."""


class Effect(NamedTuple):
    """A column that the axes may change, whatever the weights of the reward."""

    name: str
    label: str
    factor: float = 1.0
    low: float | None = None
    high: float | None = None
    """Ends of the scale; None takes those of the values."""


EFFECTS = (
    Effect("passed", "passed, %", 100.0, 0.0, 100.0),
    Effect("d_drift", "D_drift", low=0.0),
    Effect("s_sem", "S_sem"),
)


def draw(rows: Sequence[Row], axes: Sequence[str]) -> str | None:
    """Draw a sweep as SVG; return None, and say so in the log, without matplotlib.

    Left: the best reward so far, by iteration, the median over scenes and seeds with the middle
    half. Middle: what the first two axes with several values change, as lines with all runs or as
    heat maps. Right: S_sem beside D_drift of every run.

    Args:
        rows: the runs, each with its iterations under "history".
        axes: columns that distinguish points.
    """
    axes = [name for name in axes if len({row[name] for row in rows}) > 1]
    effects = EFFECTS if axes else ()
    columns = 2 + len(effects)

    def fill(figure: Any) -> None:
        places = figure.subplots(1, columns)
        _convergence(places[0], rows)
        for place, effect in zip(places[1:-1], effects, strict=True):
            _effect(figure, place, rows, axes[:2], effect)
        _terms(places[-1], rows)

    return plot_svg((3.4 * columns, 3.2), fill)


def _points(rows: Sequence[Row]) -> dict[str, list[Row]]:
    points: dict[str, list[Row]] = {}
    for row in rows:
        points.setdefault(row["point"], []).append(row)
    return points


def _convergence(place: Any, rows: Sequence[Row]) -> None:
    curves = {}
    for point, runs in _points(rows).items():
        longest = max((len(run.get("history", ())) for run in runs), default=0)
        best = np.full((len(runs), longest), np.nan)
        for line, run in zip(best, runs, strict=True):
            values = [step["best"] for step in run.get("history", ())]
            line[: len(values)] = [math.nan if value is None else value for value in values]
            line[len(values) :] = line[len(values) - 1] if values else math.nan  # It has stopped.
        if np.isfinite(best).any():
            curves[point] = best
    final = {point: float(np.nanmedian(best[:, -1])) for point, best in curves.items()}
    shown = sorted(final, key=final.__getitem__, reverse=True)[:MOST_LINES]
    for point in sorted(shown, key=list(curves).index):
        low, middle, high = _quantiles(curves[point])
        t = np.arange(1, len(middle) + 1)
        (line,) = place.plot(t, middle, marker=".", label=_short(point))
        place.fill_between(t, low, high, color=line.get_color(), alpha=0.15, linewidth=0)
    left_out = len(curves) - len(shown)
    place.set_title(
        "convergence" if not left_out else f"convergence of the best {len(shown)} of {len(curves)}"
    )
    place.set(xlabel="iteration", ylabel="best reward so far")
    place.xaxis.get_major_locator().set_params(integer=True)
    if shown:
        place.legend(fontsize=6)


def _quantiles(values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the quartiles of each iteration; NaN where no run has a value."""
    finite = [column[np.isfinite(column)] for column in values.T]
    return tuple(
        np.array([np.quantile(column, q) if len(column) else np.nan for column in finite])
        for q in (0.25, 0.5, 0.75)
    )


def _effect(
    figure: Any, place: Any, rows: Sequence[Row], axes: Sequence[str], effect: Effect
) -> None:
    name, label, factor, low, high = effect
    value = lambda row: None if row.get(name) is None else factor * float(row[name])
    levels = [sorted({row[axis] for row in rows}, key=_order) for axis in axes]
    means = _means(rows, axes, levels, value)
    if len(axes) == 1:
        known = [(levels[0].index(row[axes[0]]), value(row)) for row in rows]
        known = [(x, y) for x, y in known if y is not None]
        if known:
            place.plot(*zip(*known, strict=True), ".", color="0.7")
        place.plot(range(len(means)), means, "o-", label="mean")
        if low is not None:
            margin = 0.05 * ((high or place.get_ylim()[1]) - low)
            place.set_ylim(low - margin, None if high is None else high + margin)
    else:
        image = place.imshow(means, origin="lower", aspect="auto", vmin=low, vmax=high)
        figure.colorbar(image, ax=place)
        place.set_yticks(range(len(levels[0])), [_short(v) for v in levels[0]])
        if means.size <= MOST_CELLS:
            middle = np.mean(image.get_clim())
            for (y, x), mean in np.ndenumerate(means):
                colour = "black" if mean > middle else "white"
                place.text(x, y, f"{mean:.3g}", ha="center", va="center", color=colour)
    place.set_xticks(range(len(levels[-1])), [_short(v) for v in levels[-1]])
    place.set_xlabel(_short(axes[-1]))
    place.set_ylabel(label if len(axes) == 1 else _short(axes[0]))
    place.set_title(label)


def _means(
    rows: Sequence[Row],
    axes: Sequence[str],
    levels: Sequence[Sequence[Any]],
    value: Callable[[Row], float | None],
) -> np.ndarray:
    """Return the mean over runs at each combination of the axes' values; NaN where none has one."""
    total = np.zeros([len(level) for level in levels])
    count = np.zeros_like(total)
    for row in rows:
        number = value(row)
        if number is not None and math.isfinite(number):
            at = tuple(level.index(row[axis]) for axis, level in zip(axes, levels, strict=True))
            total[at] += number
            count[at] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _terms(place: Any, rows: Sequence[Row]) -> None:
    for passed, marker, colour in ((True, "o", "C2"), (False, "x", "C3")):
        known = [
            (row["d_drift"], row["s_sem"])
            for row in rows
            if bool(row["passed"]) is passed and None not in (row["d_drift"], row["s_sem"])
        ]
        if known:
            name = "passed" if passed else "not passed"
            place.scatter(*zip(*known, strict=True), s=14, marker=marker, c=colour, label=name)
    place.set(xlabel="D_drift, stability bounds", ylabel="S_sem", title="terms of the winners")
    if place.collections:
        place.legend(fontsize=6)


def _order(value: Any) -> tuple[bool, Any]:
    return isinstance(value, str), value


def _short(value: Any) -> str:
    """Return a label that fits: the last part of an option's path, a number in short."""
    if isinstance(value, float):
        return f"{value:g}"
    text = str(value)
    if text.startswith("refine."):
        text = text.rpartition(".")[2]
    return text if len(text) <= 40 else f"{text[:37]}..."

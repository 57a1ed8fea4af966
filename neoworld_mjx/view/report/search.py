"""Charts of the search in Step 5, as inline SVG, from refine/history.npz.

Colors are CSS variables of the page, so the charts follow its light and dark themes.
"""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from ...errors import RunError
from ...io import read_arrays
from .page import elements

TITLE = "Convergence of the search"
UNITS = {
    "d_pen": ("D_pen, mm", 1000.0),
    "d_drift": ("D_drift, bounds", 1.0),
    "s_sem": ("S_sem", 1.0),
    "prior": ("prior, sigma²", 1.0),
}
"""Label with unit of each built-in term, and the factor that converts values to this unit."""
NOT_SAMPLED = -1
"""Status of an entry of the arrays for which no candidate was sampled."""
WIDTH, HEIGHT = 460, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 84, WIDTH - 16, 14, HEIGHT - 42
_BOX = {"width": WIDTH, "height": HEIGHT}
_BOX |= {"left": _LEFT, "right": _RIGHT, "top": _TOP, "bottom": _BOTTOM}


class Series(NamedTuple):
    """A line of a chart. Non-finite values are omitted."""

    label: str
    values: NDArray
    """Values at x = 1, 2, ..., shape [x]."""
    color: str = "var(--c1)"
    dashed: bool = False


def convergence(path: Path) -> Markup:
    """Return the section with the rewards, the terms and the valid candidates over iterations.

    Args:
        path: history.npz, with the arrays `absolute`, `valid` and `status` and an array for each
            name in `term_names`, all of shape [iteration, candidate], and `term_weights` [term].
    """
    if not path.exists():
        return elements.section(TITLE, elements.missing("No refine/history.npz yet."))
    try:
        history = read_arrays(path, RunError)
    except RunError as error:
        note = f"refine/history.npz cannot be read: {error}"
        return elements.section(TITLE, elements.missing(note))
    absolute = history.get("absolute")
    if absolute is None or absolute.ndim != 2 or absolute.size == 0:
        return elements.section(TITLE, elements.missing("refine/history.npz contains no rewards."))
    if len(absolute) == 1:
        note = "The composed scene passed the final check; no search was needed."
        return elements.section(TITLE, elements.paragraph(note))
    charts = [_reward_chart(absolute), _valid_chart(history), *_term_charts(history)]
    return elements.section(TITLE, elements.div("charts", *charts))


def _reward_chart(absolute: NDArray) -> Markup:
    best = _over_finite(absolute, np.max)
    lines = [
        Series("best so far", np.fmax.accumulate(best), "var(--c3)", dashed=True),
        Series("best", best, "var(--c1)"),
        Series("mean", _over_finite(absolute, np.mean), "var(--c2)"),
    ]
    return line_chart(lines, "absolute reward")


def _valid_chart(history: Mapping[str, NDArray]) -> Markup:
    sampled = np.sum(history["status"] != NOT_SAMPLED, axis=1)
    valid = 100.0 * history["valid"].sum(1) / np.maximum(sampled, 1)
    return line_chart([Series("valid", valid, "var(--c3)")], "candidates, %")


def _term_charts(history: Mapping[str, NDArray]) -> list[Markup]:
    """Return a chart of each reward term, of the candidate with the best reward and on average."""
    absolute = history["absolute"]
    best = np.where(np.isfinite(absolute), absolute, -np.inf).argmax(axis=1)[:, None]
    charts = []
    for name, weight in zip(history["term_names"], history["term_weights"], strict=True):
        label, factor = UNITS.get(str(name), (str(name), 1.0))
        values = np.asarray(history[str(name)], float) * factor
        lines = [
            Series("candidate of best reward", np.take_along_axis(values, best, axis=1)[:, 0]),
            Series("mean", _over_finite(values, np.mean), "var(--c2)"),
        ]
        charts.append(line_chart(lines, f"{label}, weight {weight:g}"))
    return charts


def _over_finite(values: ArrayLike, function: Callable[[NDArray], Any]) -> NDArray:
    """Reduce the finite values of each iteration to one number, or NaN if there are none."""
    rows = [row[np.isfinite(row)] for row in np.asarray(values, float)]
    return np.array([float(function(row)) if row.size else np.nan for row in rows])


def line_chart(lines: list[Series], y_label: str) -> Markup:
    """Draw lines of equal length over iterations 1, 2, ... as an SVG element."""
    values = np.concatenate([np.asarray(line.values, float) for line in lines])
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return elements.missing("No finite value to draw.")
    low, high = float(finite.min()), float(finite.max())
    if high - low < 1e-12:
        low, high = low - 0.5 * max(abs(low), 1e-3), high + 0.5 * max(abs(high), 1e-3)
    ticks = nice_ticks(low, high)
    low, high = min(low, ticks[0]), max(high, ticks[-1])
    count = len(lines[0].values)
    x = np.linspace(_LEFT, _RIGHT, count) if count > 1 else np.array([(_LEFT + _RIGHT) / 2])

    def pixels(values: ArrayLike) -> NDArray:
        return _BOTTOM - (_BOTTOM - _TOP) * (np.asarray(values, float) - low) / (high - low)

    return elements.line_chart(
        _BOX,
        "iteration",
        y_label,
        [(round(float(x[i]), 1), i + 1) for i in range(0, count, max(1, math.ceil(count / 12)))],
        [(round(float(y), 1), f"{tick:g}") for tick, y in zip(ticks, pixels(ticks), strict=True)],
        [_line(line, x, pixels(line.values)) for line in lines],
    )


def nice_ticks(low: float, high: float, steps: int = 4) -> list[float]:
    """Return round numbers that cover [low, high] with about the given number of steps."""
    raw = (high - low) / steps
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * 0.999)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(k * step, 12) for k in range(first, last + 1)]


def _line(line: Series, x: NDArray, y: NDArray) -> dict[str, object]:
    """Return the attributes, dots, and runs of consecutive finite values of a line, for the SVG."""
    finite = np.flatnonzero(np.isfinite(y))
    runs = np.split(finite, np.flatnonzero(np.diff(finite) > 1) + 1)
    points = [" ".join(f"{x[i]:.1f},{y[i]:.1f}" for i in run) for run in runs if len(run) > 1]
    dots = [
        {"x": round(float(x[i]), 1), "y": round(float(y[i]), 1), "index": i + 1,
         "value": f"{line.values[i]:.4g}"}
        for i in finite.tolist()
    ]  # fmt: skip
    return {
        "label": line.label,
        "color": line.color,
        "dashed": line.dashed,
        "runs": points,
        "dots": dots,
    }

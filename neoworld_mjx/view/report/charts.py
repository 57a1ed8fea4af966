"""Line charts over iterations and horizontal bars, as inline SVG.

Colors are CSS variables of the page, so the charts follow its light and dark themes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from .page import elements

WIDTH, HEIGHT = 460, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 84, WIDTH - 16, 14, HEIGHT - 42
_BOX = {"width": WIDTH, "height": HEIGHT}
_BOX |= {"left": _LEFT, "right": _RIGHT, "top": _TOP, "bottom": _BOTTOM}


@dataclass(frozen=True)
class Series:
    """A line of a chart. Non-finite values are omitted."""

    label: str
    values: NDArray
    """Values at x = 1, 2, ..., shape [x]."""
    color: str = "var(--c1)"
    dashed: bool = False


@dataclass(frozen=True)
class Band:
    """A shaded area between two lines."""

    label: str
    low: NDArray
    high: NDArray


def line_chart(
    lines: Sequence[Series],
    *,
    y_label: str,
    x_label: str = "iteration",
    band: Band | None = None,
    limits: tuple[float, float] | None = None,
) -> Markup:
    """Draw lines over x = 1, 2, ... as an SVG element.

    Args:
        lines: lines of equal length.
        y_label: quantity and unit of the values.
        x_label: quantity along x.
        band: a shaded area behind the lines.
        limits: lowest and highest y; by default, the range of the values, extended to ticks.
    """
    arrays = [line.values for line in lines] + ([band.low, band.high] if band else [])
    finite = np.concatenate([np.asarray(array, float).ravel() for array in arrays])
    finite = finite[np.isfinite(finite)]
    if finite.size == 0:
        return elements.missing("No finite value to draw.")
    low, high = limits or (float(finite.min()), float(finite.max()))
    if high - low < 1e-12:
        low, high = low - 0.5 * max(abs(low), 1e-3), high + 0.5 * max(abs(high), 1e-3)
    ticks = nice_ticks(low, high)
    if limits is None:
        low, high = min(low, ticks[0]), max(high, ticks[-1])
    count = max(len(line.values) for line in lines)
    x = np.linspace(_LEFT, _RIGHT, count) if count > 1 else np.array([(_LEFT + _RIGHT) / 2])

    def pixels(values: ArrayLike) -> NDArray:
        return _BOTTOM - (_BOTTOM - _TOP) * (np.asarray(values, float) - low) / (high - low)

    return elements.line_chart(
        _BOX,
        x_label,
        y_label,
        [(round(float(x[i]), 1), i + 1) for i in range(0, count, max(1, math.ceil(count / 12)))],
        [
            (round(float(y), 1), f"{tick:g}")
            for tick, y in zip(ticks, pixels(ticks), strict=True)
            if _TOP - 1 <= y <= _BOTTOM + 1
        ],
        None if band is None else _band(band.label, x, pixels(band.low), pixels(band.high)),
        [_line(line, x, pixels(line.values)) for line in lines],
    )


def bars(items: Sequence[tuple[str, float]], unit: str) -> Markup:
    """Draw labeled horizontal bars with their values as an SVG element.

    Args:
        items: label and nonnegative value of each bar.
        unit: unit of the values.
    """
    highest = max((value for _, value in items), default=0.0) or 1.0
    rows = [
        {
            "label": label,
            "length": round(max(1.0, (WIDTH - 180) * value / highest), 1),
            "value": f"{value:.3g} {unit}",
        }
        for label, value in items
    ]
    return elements.bars(WIDTH, rows)


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
    return {
        "label": line.label,
        "color": line.color,
        "dashed": line.dashed,
        "runs": [_points(x[run], y[run]) for run in runs if len(run) > 1],
        "dots": [
            {
                "x": round(float(x[i]), 1),
                "y": round(float(y[i]), 1),
                "index": i + 1,
                "value": f"{line.values[i]:.4g}",
            }
            for i in finite.tolist()
        ],
    }


def _band(label: str, x: NDArray, low: NDArray, high: NDArray) -> dict[str, str] | None:
    finite = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
    if len(finite) < 2:
        return None
    back = finite[::-1]
    points = f"{_points(x[finite], high[finite])} {_points(x[back], low[back])}"
    return {"label": label, "points": points}


def _points(x: NDArray, y: NDArray) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))

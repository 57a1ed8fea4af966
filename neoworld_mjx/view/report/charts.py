"""Small charts as inline SVG: lines over iterations with a band, and horizontal bars.

Colours come from the page's CSS variables, so that the charts follow its light and dark themes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 460, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 84, 16, 14, 42


@dataclass(frozen=True)
class Series:
    """A line of a chart; points that are not finite are left out."""

    label: str
    values: NDArray
    """Shape [x]."""
    colour: str = "var(--c1)"
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
) -> str:
    """Draw lines over x = 1, 2, ... as an SVG element.

    Args:
        lines: what to draw; all values of one length.
        y_label: quantity and unit of the values.
        x_label: what is counted along x.
        band: a shaded area behind the lines.
        limits: lowest and highest y; by default what the values need.
    """
    every = [line.values for line in lines] + ([band.low, band.high] if band else [])
    flat = np.concatenate([np.asarray(v, float).ravel() for v in every]) if every else np.zeros(0)
    flat = flat[np.isfinite(flat)]
    if flat.size == 0:
        return '<p class="missing">No finite value to draw.</p>'
    low, high = limits or (float(flat.min()), float(flat.max()))
    if high - low < 1e-12:
        low, high = low - 0.5 * max(abs(low), 1e-3), high + 0.5 * max(abs(high), 1e-3)
    ticks = nice_ticks(low, high)
    if limits is None:
        low, high = min(low, ticks[0]), max(high, ticks[-1])
    count = max(len(line.values) for line in lines)

    def px(i: int) -> float:
        span = WIDTH - _LEFT - _RIGHT
        return _LEFT + span * (i / (count - 1) if count > 1 else 0.5)

    def py(v: float) -> float:
        return HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * (v - low) / (high - low)

    parts = [_frame(ticks, py, count, px, x_label, y_label)]
    if band is not None:
        parts.append(_band(band, px, py))
    for line in lines:
        parts.append(_line(line, px, py))
    legend = "".join(_key(line.label, line.colour, line.dashed) for line in lines)
    if band is not None:
        legend += _key(band.label, "var(--band)", False, block=True)
    return (
        f'<figure class="chart"><svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="{escape(y_label)} over {escape(x_label)}">{"".join(parts)}</svg>'
        f'<figcaption class="legend">{legend}</figcaption></figure>'
    )


def bars(items: Sequence[tuple[str, float]], unit: str) -> str:
    """Draw labelled horizontal bars with their values, as an SVG element.

    Args:
        items: label and value >= 0 of each bar.
        unit: written behind each value.
    """
    top = max((value for _, value in items), default=0.0) or 1.0
    row, left, right = 26, 110, 70
    parts = []
    for i, (label, value) in enumerate(items):
        y = i * row
        length = max(1.0, (WIDTH - left - right) * value / top)
        parts.append(
            f'<text class="tick" x="{left - 8}" y="{y + 17}" text-anchor="end">'
            f"{escape(label)}</text>"
            f'<rect x="{left}" y="{y + 5}" width="{length:.1f}" height="16" rx="2" '
            f'fill="var(--c1)"/>'
            f'<text class="tick" x="{left + length + 6:.1f}" y="{y + 17}">'
            f"{value:.3g} {escape(unit)}</text>"
        )
    height = max(row * len(items), 1)
    return (
        f'<figure class="chart"><svg viewBox="0 0 {WIDTH} {height}" role="img">'
        f"{''.join(parts)}</svg></figure>"
    )


def nice_ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Return round numbers that cover [low, high] in about that many steps."""
    raw = (high - low) / max(about - 1, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * 0.999)
    first = math.floor(low / step + 1e-9)
    last = math.ceil(high / step - 1e-9)
    return [round(k * step, 12) for k in range(first, last + 1)]


def _frame(ticks, py, count, px, x_label: str, y_label: str) -> str:
    parts = []
    for tick in ticks:
        y = py(tick)
        if not _TOP - 1 <= y <= HEIGHT - _BOTTOM + 1:
            continue
        parts.append(
            f'<line class="grid" x1="{_LEFT}" x2="{WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
            f'<text class="tick" x="{_LEFT - 7}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>'
        )
    every = max(1, math.ceil(count / 12))
    for i in range(0, count, every):
        parts.append(
            f'<text class="tick" x="{px(i):.1f}" y="{HEIGHT - _BOTTOM + 17}" '
            f'text-anchor="middle">{i + 1}</text>'
        )
    middle = (HEIGHT - _BOTTOM + _TOP) / 2
    parts.append(
        f'<text class="axis" x="{(WIDTH + _LEFT - _RIGHT) / 2}" y="{HEIGHT - 6}" '
        f'text-anchor="middle">{escape(x_label)}</text>'
        f'<text class="axis" transform="translate(13 {middle}) rotate(-90)" '
        f'text-anchor="middle">{escape(y_label)}</text>'
    )
    return "".join(parts)


def _line(line: Series, px, py) -> str:
    dash = ' stroke-dasharray="5 4"' if line.dashed else ""
    runs: list[list[str]] = [[]]
    dots = []
    for i, value in enumerate(np.asarray(line.values, float)):
        if not np.isfinite(value):
            runs.append([])
            continue
        runs[-1].append(f"{px(i):.1f},{py(value):.1f}")
        dots.append(
            f'<circle cx="{px(i):.1f}" cy="{py(value):.1f}" r="3" fill="{line.colour}">'
            f"<title>{escape(line.label)}, {i + 1}: {value:.4g}</title></circle>"
        )
    drawn = "".join(
        f'<polyline points="{" ".join(run)}" fill="none" stroke="{line.colour}" '
        f'stroke-width="2"{dash}/>'
        for run in runs
        if len(run) > 1
    )
    return drawn + "".join(dots)


def _band(band: Band, px, py) -> str:
    low, high = np.asarray(band.low, float), np.asarray(band.high, float)
    good = [i for i in range(len(low)) if np.isfinite(low[i]) and np.isfinite(high[i])]
    if len(good) < 2:
        return ""
    points = [f"{px(i):.1f},{py(high[i]):.1f}" for i in good]
    points += [f"{px(i):.1f},{py(low[i]):.1f}" for i in reversed(good)]
    return f'<polygon points="{" ".join(points)}" fill="var(--band)" stroke="none"/>'


def _key(label: str, colour: str, dashed: bool, *, block: bool = False) -> str:
    dash = ' stroke-dasharray="5 4"' if dashed else ""
    width = 10 if block else 2.5
    return (
        f'<span><svg width="26" height="12"><line x1="1" x2="25" y1="6" y2="6" '
        f'stroke="{colour}" stroke-width="{width}"{dash}/></svg>{escape(label)}</span>'
    )

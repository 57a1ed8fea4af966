"""Growth of cost with the number of objects: power laws and a chart."""

import json
import math
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from neoworld_mjx.errors import ConfigError
from neoworld_mjx.io.files import write_atomic

from .throughput import PhysicsRow

_WIDTH, _HEIGHT = 640, 400
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 190, 24, 52
_COLOURS = ("#1b6ca8", "#d1495b", "#3d8b40", "#8f5fb0", "#c77d0a", "#5b6770")
_LOOP = "naive loop"


class Growth(NamedTuple):
    """Cost over objects of one engine, and the power law through it."""

    label: str
    objects: list[int]
    cost_ms: list[float]
    """Time of a candidate [ms]."""
    exponent: float
    """b of cost = a objects^b, by least squares in the logarithms; nan for a single point."""


def growth(rows: Iterable[PhysicsRow], *, core: bool = False) -> list[Growth]:
    """Fit a power law to the cost of a candidate, for every engine with and without early stop.

    Of several populations each engine's lowest cost counts.

    Args:
        rows: of `physics`.
        core: count processor time in place of time; only `native` and the naive loop have it.
    """
    best: dict[str, dict[int, float]] = {}
    for row in rows:
        for label, cost in (_core_costs if core else _costs)(row):
            if cost is not None:
                known = best.setdefault(label, {})
                known[row.objects] = min(known.get(row.objects, math.inf), cost)
    return [
        Growth(label, sorted(costs), [costs[n] for n in sorted(costs)], _exponent(costs))
        for label, costs in sorted(best.items())
    ]


def growth_json(curves: Iterable[Growth]) -> list[dict[str, Any]]:
    """Return curves as JSON; an undefined exponent is None."""
    return [
        g._asdict() | {"exponent": None if math.isnan(g.exponent) else g.exponent} for g in curves
    ]


def read_rows(file: Path) -> list[PhysicsRow]:
    """Read the rows of the output of `bench run physics --json`.

    Raises:
        ConfigError: the file cannot be read, or has no such rows.
    """
    try:
        result = json.loads(file.read_text(encoding="utf-8"))
        return [PhysicsRow.model_validate(row) for row in result["rows"]]
    except OSError as error:
        raise ConfigError(f"cannot read {file}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, ValidationError):
        raise ConfigError(f"{file} is not what bench run physics --json prints") from None


def write_chart(file: Path, curves: Sequence[Growth], *, core: bool = False) -> None:
    """Write the chart of curves as an SVG file; see `growth_svg`.

    Raises:
        ConfigError: the file cannot be written.
    """
    try:
        write_atomic(file, growth_svg(curves, core=core).encode())
    except OSError as error:
        raise ConfigError(f"cannot write {file}: {error.strerror}") from None


def _costs(row: PhysicsRow) -> list[tuple[str, float | None]]:
    cost = lambda rate: None if rate is None else 1e3 / rate
    return [
        (_label(row), cost(row.candidates_per_s)),
        (_LOOP, cost(row.naive_candidates_per_s)),
        ("bare scan of mjx.step", cost(row.bare_scan_candidates_per_s)),
    ]


def _core_costs(row: PhysicsRow) -> list[tuple[str, float | None]]:
    return [(_label(row), row.core_ms), (_LOOP, row.naive_core_ms)]


def _label(row: PhysicsRow) -> str:
    return f"{row.engine}, early stop" if row.early_stop else row.engine


def _exponent(costs: dict[int, float]) -> float:
    if len(costs) < 2:
        return math.nan
    return float(np.polyfit(np.log(list(costs)), np.log(list(costs.values())), 1)[0])


def growth_svg(curves: Sequence[Growth], *, core: bool = False) -> str:
    """Draw cost over objects with both axes logarithmic, as a whole SVG file on white.

    Args:
        curves: what to draw.
        core: whether the costs are of processor time.
    """
    objects = sorted({n for g in curves for n in g.objects})
    costs = [c for g in curves for c in g.cost_ms]
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        'font-family="sans-serif" font-size="12" role="img" '
        'aria-label="Time of a candidate over number of objects">'
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="#fff"/>'
    ]
    if costs:
        low, high = math.floor(math.log10(min(costs))), math.ceil(math.log10(max(costs)) + 1e-9)
        left, right = math.log(objects[0] * 0.9), math.log(objects[-1] * 1.1)
        px = lambda n: (
            _LEFT + (_WIDTH - _LEFT - _RIGHT) * (math.log(n) - left) / max(right - left, 1e-9)
        )
        py = lambda c: (
            _HEIGHT
            - _BOTTOM
            - (_HEIGHT - _TOP - _BOTTOM) * (math.log10(c) - low) / max(high - low, 1)
        )
        cost = "processor time" if core else "time"
        parts += _axes(f"{cost} of a candidate [ms]", objects, low, max(high, low + 1), px, py)
        for k, g in enumerate(curves):
            parts += _curve(g, _COLOURS[k % len(_COLOURS)], k, px, py)
    return "".join(parts) + "</svg>\n"


def _axes(label: str, objects: list[int], low: int, high: int, px, py) -> list[str]:
    parts = []
    for power in range(low, high + 1):
        y = py(10.0**power)
        parts.append(
            f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>'
            f'<text x="{_LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{10.0**power:g}</text>'
        )
    for n in objects:
        parts.append(
            f'<text x="{px(n):.1f}" y="{_HEIGHT - _BOTTOM + 18}" text-anchor="middle">{n}</text>'
        )
    middle = (_HEIGHT - _BOTTOM + _TOP) / 2
    parts.append(
        f'<text x="{(_WIDTH - _RIGHT + _LEFT) / 2}" y="{_HEIGHT - 12}" text-anchor="middle">'
        "objects</text>"
        f'<text transform="translate(18 {middle}) rotate(-90)" text-anchor="middle">'
        f"{label}</text>"
    )
    return parts


def _curve(g: Growth, colour: str, index: int, px, py) -> list[str]:
    points = [(px(n), py(c)) for n, c in zip(g.objects, g.cost_ms, strict=True)]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dash = ' stroke-dasharray="5 4"' if "early" in g.label else ""
    parts = [f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"{dash}/>']
    for (x, y), n, cost in zip(points, g.objects, g.cost_ms, strict=True):
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}">'
            f"<title>{escape(g.label)}, {n} objects: {cost:.3g} ms</title></circle>"
        )
    at = _TOP + 12 + 34 * index
    law = "" if math.isnan(g.exponent) else f"objects^{g.exponent:.2f}"
    parts.append(
        f'<line x1="{_WIDTH - _RIGHT + 14}" x2="{_WIDTH - _RIGHT + 40}" y1="{at}" y2="{at}" '
        f'stroke="{colour}" stroke-width="2"{dash}/>'
        f'<text x="{_WIDTH - _RIGHT + 46}" y="{at + 4}">{escape(g.label)}</text>'
        f'<text x="{_WIDTH - _RIGHT + 46}" y="{at + 18}" fill="#666">{law}</text>'
    )
    return parts

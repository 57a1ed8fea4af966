"""Growth of cost with the number of objects: power laws and a chart."""

import json
import math
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from neoworld_mjx.errors import ConfigError
from neoworld_mjx.io.files import write_atomic
from neoworld_mjx.render.plots import plot_svg

from .throughput import PhysicsRow

_LOOP = "naive loop"


class Growth(NamedTuple):
    """Cost over objects of one engine, and the power law through it."""

    label: str
    objects: list[int]
    cost_ms: list[float]
    """Time per candidate [ms]."""
    exponent: float
    """b of cost = a objects^b, by least squares in the logarithms; nan for a single point."""


def growth(rows: Iterable[PhysicsRow], *, core: bool = False) -> list[Growth]:
    """Fit a power law to the cost of a candidate, for every engine with and without early stop.

    The lowest cost over all populations counts.

    Args:
        rows: of `physics`.
        core: use processor time instead of wall time; only `native` and the naive loop have it.
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
    """Draw cost over the number of objects on logarithmic axes as an SVG file.

    Args:
        file: to write.
        curves: of `growth`.
        core: True if the costs are processor time.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    cost = "processor time" if core else "time"

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        axes.set(xscale="log", yscale="log", xlabel="objects")
        axes.set_ylabel(f"{cost} of a candidate [ms]")
        for g in curves:
            law = "" if math.isnan(g.exponent) else f" ~ objects^{g.exponent:.2f}"
            style = "--" if "early" in g.label else "-"
            axes.plot(g.objects, g.cost_ms, style, marker="o", label=g.label + law)
        counts = sorted({n for g in curves for n in g.objects})
        axes.set_xticks(counts, [str(n) for n in counts], minor=False)
        axes.minorticks_off()
        axes.grid(axis="y", color="0.9")
        if curves:
            figure.legend(loc="outside right upper")

    require_matplotlib()
    svg = plot_svg((6.4, 4.0), draw) or ""
    try:
        write_atomic(file, svg.encode())
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


def require_matplotlib() -> None:
    """Raise a ConfigError if matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise ConfigError("charts need matplotlib: uv sync --inexact --extra plot")

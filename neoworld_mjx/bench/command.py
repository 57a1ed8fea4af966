"""The suites of `neoworld bench`: each takes its options, logs rows as they come, and returns
JSON.
"""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
from pydantic import ValidationError

from ..config import Config
from ..errors import ConfigError
from ..files import write_atomic
from . import agreement as comparing
from . import suites
from .growth import Growth, growth, growth_svg
from .kernels import dispatch, kernels
from .machine import machine
from .penetration import accuracy, random_pairs
from .physics import PhysicsRow, physics
from .rows import collect, plain

if TYPE_CHECKING:
    from ..commands.bench_commands import BenchChartCommand


def physics_answer(o: suites.Physics) -> dict[str, Any]:
    """Time engines."""
    about = machine()
    rows = collect(
        physics(
            o.objects,
            o.population,
            o.engine,
            duration=o.duration,
            budget=o.budget,
            seed=o.seed,
        )
    )
    if o.chart is not None:
        _write(o.chart, growth_svg(growth(rows)))
    return {"machine": about, "rows": plain(rows), "growth": _exponents(growth(rows))}


def kernels_answer(o: suites.Kernels) -> dict[str, Any]:
    """Time penetration terms."""
    about = machine()
    rows = collect(
        kernels(o.objects, o.population, samples=o.samples, seed=o.seed, budget=o.budget)
    )
    if o.table is not None:
        _enter(o.table, dispatch(rows))
    pairs = plain(collect(accuracy(random_pairs(o.pairs, seed=o.seed)))) if o.pairs else []
    return {"machine": about, "rows": plain(rows), "accuracy": pairs}


def agreement_answer(o: suites.Agreement) -> dict[str, Any]:
    """Compare engines."""
    rows = collect(comparing.agreement(o.scene, o.engine, layouts=o.layouts, seed=o.seed))
    return {
        **comparing.agreed(rows),
        "machine": machine(),
        "models": plain([row for row in rows if isinstance(row, comparing.ModelRow)]),
        "verdicts": plain([row for row in rows if isinstance(row, comparing.VerdictRow)]),
    }


def refine_answer(o: suites.Refine, config: Config) -> dict[str, Any]:
    """Refine from noisy starts, with the configuration's options of refinement."""
    from .refine import refinements, summary

    rows = collect(
        refinements(
            o.scene,
            seeds=o.seeds,
            baseline_seeds=o.baseline_seeds,
            baselines=o.baseline,
            options=config.refine,
            engine=o.engine,
        )
    )
    return {**summary(rows), "machine": machine(), "rows": plain(rows)}


def chart_answer(o: "BenchChartCommand") -> dict[str, Any]:
    """Draw the growth of cost from stored rows."""
    try:
        answer = json.loads(o.rows.read_text(encoding="utf-8"))
        rows = [PhysicsRow.model_validate(row) for row in answer["rows"]]
    except OSError as error:
        raise ConfigError(f"cannot read {o.rows}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, ValidationError):
        raise ConfigError(f"{o.rows} is not what bench run physics --json prints") from None
    curves = growth(rows, core=o.core)
    _write(o.out, growth_svg(curves, core=o.core))
    return {"chart": str(o.out), "growth": _exponents(curves)}


def _exponents(curves: Iterable[Growth]) -> list[dict[str, Any]]:
    return [
        {
            "label": g.label,
            "objects": g.objects,
            "cost_ms": g.cost_ms,
            "exponent": None if math.isnan(g.exponent) else g.exponent,
        }
        for g in curves
    ]


def _enter(path: Path, entry: dict[str, Any]) -> None:
    """Add or replace this device's entry in a table of measured devices."""
    try:
        table = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"devices": {}}
        table["devices"][jax.devices()[0].device_kind] = entry
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path} is no table of measured devices: {error}") from None
    _write(path, json.dumps(table, indent=1) + "\n")


def _write(path: Path, text: str) -> None:
    try:
        write_atomic(path, text.encode())
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from None

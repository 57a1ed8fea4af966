"""The benchmarks as `neoworld bench` runs them: options in, one answer out, rows told as they come."""

import json
import logging
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

import jax
from pydantic import BaseModel, ValidationError

from ..config import RefineOptions
from ..errors import ConfigError
from ..files import write_atomic
from . import agreement as comparing
from .growth import Growth, growth, growth_svg
from .kernels import dispatch, kernels
from .machine import machine
from .penetration import accuracy, random_pairs
from .physics import PhysicsRow, physics

log = logging.getLogger(__name__)

Row = TypeVar("Row", bound=BaseModel)


def physics_answer(o: Any) -> dict[str, Any]:
    """Time engines; options are those of `arguments.BenchPhysics`."""
    about = machine()
    rows = _told(
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
    return {"machine": about, "rows": _plain(rows), "growth": _exponents(growth(rows))}


def kernels_answer(o: Any) -> dict[str, Any]:
    """Time penetration terms; options are those of `arguments.BenchKernels`."""
    about = machine()
    rows = _told(kernels(o.objects, o.population, samples=o.samples, seed=o.seed, budget=o.budget))
    if o.table is not None:
        _enter(o.table, dispatch(rows))
    told = _plain(_told(accuracy(random_pairs(o.pairs, seed=o.seed)))) if o.pairs else []
    return {"machine": about, "rows": _plain(rows), "accuracy": told}


def agreement_answer(o: Any) -> dict[str, Any]:
    """Compare engines; options are those of `arguments.BenchAgreement`."""
    rows = _told(comparing.agreement(o.scene, o.engine, layouts=o.layouts, seed=o.seed))
    return {
        **comparing.agreed(rows),
        "machine": machine(),
        "models": _plain([row for row in rows if isinstance(row, comparing.ModelRow)]),
        "verdicts": _plain([row for row in rows if isinstance(row, comparing.VerdictRow)]),
    }


def programs_answer(o: Any) -> dict[str, Any]:
    """Test the sandbox and time a cabinet; options are those of `arguments.BenchPrograms`."""
    from .programs import programs

    return programs(hostile=not o.no_hostile, mutations=o.mutations, repeats=o.repeats, seed=o.seed)


def refine_answer(o: Any, options: RefineOptions) -> dict[str, Any]:
    """Refine from noisy starts; options are those of `arguments.BenchRefine`."""
    from .refine import refinements, summary

    rows = _told(
        refinements(
            o.scene,
            seeds=o.seeds,
            baseline_seeds=o.baseline_seeds,
            baselines=o.baseline,
            options=options,
            engine=o.engine,
        )
    )
    return {**summary(rows), "machine": machine(), "rows": _plain(rows)}


def scoring_answer(o: Any) -> dict[str, Any]:
    """Score while physics runs; options are those of `arguments.BenchScoring`."""
    from .scoring import scoring

    rows = _told(
        scoring(
            wait,
            real=physics == "native",
            iterations=o.iterations,
            physics_s=o.physics_s,
            delay_s=o.delay_s,
            failing=o.failing,
            seed=o.seed,
        )
        for physics in o.physics
        for wait in o.wait
    )
    return {
        "worst_ratio": max(row.ratio for row in rows),
        "lost": sum(row.submitted - row.scored for row in rows),
        "misplaced": sum(row.misplaced for row in rows),
        "machine": machine(),
        "rows": _plain(rows),
    }


def verify_answer(o: Any) -> dict[str, Any]:
    """Put faults into sound objects; options are those of `arguments.BenchVerify`."""
    from .verify import summary, verify_matrix

    rows = _told(verify_matrix(o.objects, o.kind, mend=not o.no_repair, workers=o.workers))
    return {**summary(rows), "machine": machine()}


def battery_answer(o: Any) -> dict[str, Any]:
    """Simulate many objects at once; options are those of `arguments.BenchBattery`."""
    from .battery import batteries

    rows = _told(batteries(o.objects, o.engine, together=o.together))
    return {"machine": machine(), "rows": _plain(rows)}


def chart_answer(o: Any) -> dict[str, Any]:
    """Draw stored rows; options are those of `arguments.BenchChart`."""
    try:
        found = json.loads(o.rows.read_text(encoding="utf-8"))
        rows = [PhysicsRow.model_validate(row) for row in found["rows"]]
    except OSError as error:
        raise ConfigError(f"cannot read {o.rows}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, ValidationError):
        raise ConfigError(f"{o.rows} is not what bench run physics --json prints") from None
    found = growth(rows, core=o.core)
    _write(o.out, growth_svg(found, core=o.core))
    return {"chart": str(o.out), "growth": _exponents(found)}


def _told(rows: Iterable[Row]) -> list[Row]:
    """Collect rows, and log each as soon as it is there."""
    kept = []
    for row in rows:
        kept.append(row)
        shown = {k: v for k, v in row.model_dump().items() if v not in (None, "", [], "ok")}
        log.info(", ".join(f"{k} {_short(v)}" for k, v in shown.items()))
    return kept


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _plain(rows: Iterable[BaseModel]) -> list[dict[str, Any]]:
    return [row.model_dump() for row in rows]


def _exponents(found: Iterable[Growth]) -> list[dict[str, Any]]:
    return [
        {
            "label": g.label,
            "objects": g.objects,
            "cost_ms": g.cost_ms,
            "exponent": None if math.isnan(g.exponent) else g.exponent,
        }
        for g in found
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

"""Results of single runs, and the Parquet file that holds them."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RunError
from ..io import parquet_files
from ..measure import SceneMeasure
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..refinement.outcome import Refined
from ..refinement.returning import Winner
from ..refinement.search_run import SearchResult
from .cases import Case
from .plan import plain

Row = dict[str, Any]
"""One run: scene, point, seed, the values of the point, and the results."""

COLUMNS: dict[str, type] = {
    "valid": bool,
    "passed": bool,
    "reward": float,
    "d_pen_m": float,
    "d_drift": float,
    "s_sem": float,
    "prior": float,
    "iterations": int,
    "rollouts": int,
    "pruned": int,
    "mean_log_scale": float,
    "max_depth_m": float,
    "max_drift_m": float,
    "max_tilt_deg": float,
    "xy_error_m": float,
    "yaw_error_deg": float,
    "scale_error": float,
    "box_iou": float,
    "seconds": float,
    "to_valid_s": float,
    "engine": str,
    "fingerprint": str,
}
"""Columns of a run; None where one does not apply. `valid` is of the search, `passed` of the exact
check; `reward` is the absolute one, of the winner, as are the terms. `seconds` is the time of the
search without compiling: of runs in one computation an equal share. Depth, drift and tilt are of
the check, `box_iou` of the objects' visible boxes with those parsed from the photograph."""


TERM = "term_"
"""Prefix of the columns of reward terms that COLUMNS does not list."""
TERM_COLUMNS = {"d_pen": "d_pen_m", "d_drift": "d_drift", "s_sem": "s_sem", "prior": "prior"}
"""Columns of the built-in reward terms."""


def row_of_refined(case: Case, model: SceneModel, refined: Refined) -> Row:
    """Return the columns of a single refinement."""
    history = refined.history
    to_valid = refined.seconds["to_valid"]
    outcome = {
        "passed": refined.passed,
        "iterations": refined.iterations,
        "rollouts": refined.rollouts,
        "pruned": refined.pruned,
        "seconds": refined.seconds["search"],
        "to_valid_s": None if np.isnan(to_valid) else to_valid,
        "engine": refined.engine,
    }
    t, k = refined.winner
    values = None if t < 0 else {name: x[t, k] for name, x in history.items() if x.ndim == 2}
    winner = _winner(values, history["term_names"])
    return outcome | winner | _of_layout(case, model, refined.layout, refined.measure)


def row_of_search(case: Case, model: SceneModel, result: SearchResult, winner: Winner) -> Row:
    """Return the columns of one run of a search; the caller adds time and engine."""
    chosen = winner.chosen
    outcome = {
        "passed": chosen.passed,
        "iterations": len(result.rounds),
        "rollouts": result.rollouts,
        "pruned": result.pruned,
    }
    t, k = chosen.index
    values = None
    if t >= 0:
        scores = result.rounds[t].scores
        values = {name: x[k] for name, x in scores.terms.items()}
        values |= {"valid": scores.valid[k], "absolute": scores.absolute[k]}
    terms = _winner(values, [term.name for term in result.problem.objective.terms])
    return outcome | terms | _of_layout(case, model, winner.layout, chosen.measure)


def _winner(values: Mapping[str, Any] | None, terms: Iterable[Any]) -> Row:
    """Return the columns of the winning candidate; None where every candidate failed."""
    number = lambda name: None if values is None else float(values[name])
    columns = {TERM_COLUMNS.get(name, TERM + name): number(name) for name in map(str, terms)}
    valid = values is not None and bool(values["valid"])
    return {"valid": valid, "reward": number("absolute"), **columns}


def _of_layout(case: Case, model: SceneModel, layout: Layout, measure: SceneMeasure) -> Row:
    moves = np.asarray(model.optimised)
    logs = np.asarray(layout.log_scale[0])[moves]
    errors = case.errors(model, layout) if case.errors is not None else {}
    return {
        "mean_log_scale": float(logs.mean()) if len(logs) else 0.0,
        "max_depth_m": measure.max_depth_m,
        "max_drift_m": measure.max_drift_m,
        "max_tilt_deg": measure.max_tilt_deg,
        "xy_error_m": errors.get("xy_m"),
        "yaw_error_deg": errors.get("yaw_deg"),
        "scale_error": errors.get("scale"),
        "box_iou": errors.get("box_iou"),
    }


def write_parquet(path: Path, rows: Sequence[Row], values: Sequence[str]) -> None:
    """Write rows, replacing the file atomically.

    Args:
        path: of the file.
        rows: the runs.
        values: columns that distinguish points.

    Raises:
        RunError: the file cannot be written.
    """
    kinds: dict[str, type] = {"scene": str, "point": str, "seed": int}
    kinds |= {name: _kind([row.get(name) for row in rows]) for name in values}
    kinds |= COLUMNS | dict.fromkeys(term_columns(rows), float)
    write_rows(path, rows, kinds)


def write_rows(path: Path, rows: Sequence[Row], kinds: Mapping[str, type]) -> None:
    """Write columns of rows as Parquet, replacing the file atomically; None is a gap.

    Raises:
        RunError: the file cannot be written.
    """
    cells = [{name: _cell(row.get(name), kind) for name, kind in kinds.items()} for row in rows]
    parquet_files.write_rows(path, cells, kinds, RunError)


def read_parquet(path: Path) -> list[Row]:
    """Read runs back.

    Raises:
        RunError: the file cannot be read, or is no Parquet file.
    """
    return read_rows(path, ("scene", "point", "seed", "fingerprint"))


def read_rows(path: Path, needed: Iterable[str]) -> list[Row]:
    """Read rows of a Parquet file that has some columns at least.

    Raises:
        RunError: the file cannot be read, is no Parquet file, or lacks a column.
    """
    return parquet_files.read_rows(path, tuple(needed), RunError)


def _kind(values: Sequence[Any]) -> type:
    """Return the one type that holds all values of an axis."""
    kinds = {type(plain(value)) for value in values if value is not None}
    if kinds == {int, float}:
        return float
    return kinds.pop() if len(kinds) == 1 else str


def _cell(value: Any, kind: type) -> Any:
    if value is None:
        return None
    return kind(plain(value) if kind is str else value)


def term_columns(rows: Sequence[Row]) -> list[str]:
    """Return the columns of reward terms beyond COLUMNS that rows have, in order."""
    return list(dict.fromkeys(name for row in rows for name in row if name.startswith(TERM)))


Key = tuple[str, str, int]


def key(row: Mapping[str, Any]) -> Key:
    """Return the key of a row: scene, point and seed."""
    return row["scene"], row["point"], row["seed"]

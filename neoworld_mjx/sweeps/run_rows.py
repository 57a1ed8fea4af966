"""Rows of a sweep, one per run and one per iteration of a run, and their Parquet files."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RunError
from ..io import parquet_files
from ..measure import SceneMeasure
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..refinement.choosing import Winner
from ..refinement.outcome import Refined, iteration_summary
from ..refinement.search_run import SearchResult
from .cases import Case
from .plan import plain

Row = dict[str, Any]
"""A run: scene, point, seed, the values of the point, and the results; or an iteration."""
Key = tuple[str, str, int]

KEYS: dict[str, type] = {"scene": str, "point": str, "seed": int}
TERM_COLUMNS = {"d_pen": "d_pen_m", "d_drift": "d_drift", "s_sem": "s_sem", "prior": "prior"}
"""Columns of the built-in reward terms."""
TERM = "term_"
"""Prefix of the columns of custom reward terms in the rows of runs."""
_TERMS: dict[str, type] = dict.fromkeys(TERM_COLUMNS.values(), float)

COLUMNS: dict[str, type] = {
    "valid": bool,
    "passed": bool,
    "reward": float,
    **_TERMS,
    "iterations": int,
    "rollouts": int,
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
"""Columns of a run; None where one does not apply. `valid` is the result of the search, `passed` of
the final check; `reward` (absolute) and the terms are the winner's. `seconds` is the time of the
search without compilation, for runs in one computation an equal share. Depth, drift and tilt are
measured in the final check; `box_iou` compares the visible boxes with the parsed ones."""

ITERATION_COLUMNS: dict[str, type] = {
    **KEYS,
    "iteration": int,
    "best": float,
    "mean": float,
    "valid": float,
    **_TERMS,
}
"""Columns of an iteration, counted from 1: best absolute reward so far, mean over the candidates
that have one, fraction of valid candidates, and terms of the iteration's best candidate. Further
columns are custom reward terms."""


def row_key(row: Mapping[str, Any]) -> Key:
    """Return the key of a row: scene, point and seed."""
    return row["scene"], row["point"], row["seed"]


def row_of_refined(case: Case, model: SceneModel, refined: Refined) -> Row:
    """Return the columns of a single refinement."""
    history = refined.history
    to_valid = refined.seconds["to_valid"]
    t, k = refined.winner
    values = None if t < 0 else {name: x[t, k] for name, x in history.items() if x.ndim == 2}
    return {
        "passed": refined.passed,
        "iterations": refined.iterations,
        "rollouts": refined.rollouts,
        "seconds": refined.seconds["search"],
        "to_valid_s": None if np.isnan(to_valid) else to_valid,
        "engine": refined.engine,
        **_winner_columns(values, history["term_names"]),
        **_layout_columns(case, model, refined.layout, refined.measure),
    }


def row_of_search(case: Case, model: SceneModel, result: SearchResult, winner: Winner) -> Row:
    """Return the columns of one run of a search; the caller adds time and engine."""
    t, k = winner.index
    values = None
    if t >= 0:
        scores = result.rounds[t].scores
        values = {name: x[k] for name, x in scores.terms.items()}
        values |= {"valid": scores.valid[k], "absolute": scores.absolute[k]}
    return {
        "passed": winner.passed,
        "iterations": len(result.rounds),
        "rollouts": result.rollouts,
        **_winner_columns(values, [term.name for term in result.problem.objective.terms]),
        **_layout_columns(case, model, winner.layout, winner.measure),
    }


def _winner_columns(values: Mapping[str, Any] | None, terms: Iterable[Any]) -> Row:
    """Return the columns of the winning candidate; None if every candidate failed."""
    columns = {TERM_COLUMNS.get(name, TERM + name): name for name in map(str, terms)}
    columns = {"reward": "absolute"} | columns
    valid = values is not None and bool(values["valid"])
    return {"valid": valid} | {
        column: None if values is None else float(values[name]) for column, name in columns.items()
    }


def _layout_columns(case: Case, model: SceneModel, layout: Layout, measure: SceneMeasure) -> Row:
    log_scales = np.asarray(layout.log_scale[0])[np.asarray(model.optimised)]
    errors = case.errors(model, layout) if case.errors is not None else {}
    return {
        "mean_log_scale": float(log_scales.mean()) if len(log_scales) else 0.0,
        "max_depth_m": measure.max_depth_m,
        "max_drift_m": measure.max_drift_m,
        "max_tilt_deg": measure.max_tilt_deg,
        "xy_error_m": errors.get("xy_m"),
        "yaw_error_deg": errors.get("yaw_deg"),
        "scale_error": errors.get("scale"),
        "box_iou": errors.get("box_iou"),
    }


def summaries(history: Mapping[str, np.ndarray]) -> list[Row]:
    """Summarize the iterations of a refinement's history; see `iteration_summary`."""
    terms = [str(name) for name in history["term_names"]]
    names = ("absolute", "valid", "status", *terms)
    return [
        iteration_summary({name: history[name][t] for name in names}, terms)
        for t in range(len(history["absolute"]))
    ]


def iteration_rows(steps: Sequence[Row]) -> list[Row]:
    """Return the rows of a run's iterations, without the key, from their summaries."""
    rows: list[Row] = []
    best = -np.inf
    for t, step in enumerate(steps, start=1):
        best = best if step["best"] is None else max(best, step["best"])
        columns = {TERM_COLUMNS.get(name, name): value for name, value in step.items()}
        rows.append({"iteration": t, **columns, "best": best if np.isfinite(best) else None})
    return rows


def term_columns(rows: Sequence[Row]) -> list[str]:
    """Return the columns of custom reward terms, in order."""
    return list(dict.fromkeys(name for row in rows for name in row if name.startswith(TERM)))


def write_runs(path: Path, rows: Sequence[Row], values: Sequence[str]) -> None:
    """Write runs to a Parquet file.

    Args:
        path: the file.
        rows: the runs.
        values: columns that distinguish points.

    Raises:
        RunError: the file cannot be written.
    """
    kinds = KEYS | {name: _column_type([row.get(name) for row in rows]) for name in values}
    _write(path, rows, kinds | COLUMNS | dict.fromkeys(term_columns(rows), float))


def write_iterations(path: Path, rows: Sequence[Row]) -> None:
    """Write the iterations of runs, which are under "history" of each row.

    Raises:
        RunError: the file cannot be written.
    """
    iterations = [
        {name: row[name] for name in KEYS} | step for row in rows for step in row.get("history", ())
    ]
    names = (name for step in iterations for name in step if name not in ITERATION_COLUMNS)
    _write(path, iterations, ITERATION_COLUMNS | dict.fromkeys(names, float))


def read_runs(path: Path) -> list[Row]:
    """Read runs from a Parquet file.

    Raises:
        RunError: the file cannot be read, is not a Parquet file, or lacks a column.
    """
    return parquet_files.read_rows(path, (*KEYS, "fingerprint"), RunError)


def add_iterations(path: Path, rows: Sequence[Row]) -> list[Row]:
    """Return runs with their iterations, read from a file that may be missing.

    Raises:
        RunError: the file cannot be read.
    """
    histories: dict[Key, list[Row]] = {row_key(row): [] for row in rows}
    if path.exists():
        for step in parquet_files.read_rows(path, tuple(ITERATION_COLUMNS), RunError):
            columns = {name: value for name, value in step.items() if name not in KEYS}
            histories.setdefault(row_key(step), []).append(columns)
    return [row | {"history": histories[row_key(row)]} for row in rows]


def _write(path: Path, rows: Sequence[Row], kinds: Mapping[str, type]) -> None:
    cells = [{name: _cell(row.get(name), kind) for name, kind in kinds.items()} for row in rows]
    parquet_files.write_rows(path, cells, kinds, RunError)


def _column_type(values: Sequence[Any]) -> type:
    """Return the type that holds all values of an axis."""
    types = {type(plain(value)) for value in values if value is not None}
    if types == {int, float}:
        return float
    return types.pop() if len(types) == 1 else str


def _cell(value: Any, kind: type) -> Any:
    if value is None:
        return None
    return kind(plain(value) if kind is str else value)

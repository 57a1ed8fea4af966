"""Rows of a sweep, for each run and for each iteration of a run, and their Parquet files."""

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
from ..refinement.search_run import SearchResult, TimeToValid
from ..spec import SceneSpec
from .cases import Case
from .plan import plain_value

Row = dict[str, Any]
"""Row of a run (scene, point, seed, values of the point, and results), or of an iteration."""
Key = tuple[str, str, int]
"""Scene, point and seed of a run."""

KEYS: dict[str, type] = {"scene": str, "point": str, "seed": int}
"""Columns that identify a run."""
TERM_COLUMNS = {"d_pen": "d_pen_m", "d_drift": "d_drift", "s_sem": "s_sem", "prior": "prior"}
"""Columns of the reward terms that every run has, by the name of the term."""
TERM, CANDIDATE = "term_", "candidate_"
"""Prefixes of the columns of further reward terms, and of values of the winning candidate."""
_TERMS: dict[str, type] = dict.fromkeys(TERM_COLUMNS.values(), float)

COLUMNS: dict[str, type] = {
    "valid": bool,
    "passed": bool,
    "reward": float,
    "merit": float,
    **_TERMS,
    **{CANDIDATE + name: float for name in ("reward", "merit", *_TERMS)},
    "iterations": int,
    "rollouts": int,
    "iterations_to_valid": int,
    "rollouts_to_valid": int,
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
"""Columns of a run. A value is None if it does not apply to the run.

- `passed`, `max_depth_m`, `max_drift_m` and `max_tilt_deg`: result and measures of the final check.
- `reward` (the absolute reward), `merit` and the terms: values of the delivered scene, which is the
  settled winner.
- `candidate_*` and `valid`: values of the winning candidate, by which the search ranked it, and
  whether it was valid.
- `xy_error_m`, `yaw_error_deg`, `scale_error` and `box_iou`: errors of the delivered scene, if the
  scene has ground truth. `box_iou` compares visible boxes with the parsed boxes.
- `iterations_to_valid` and `rollouts_to_valid`: iterations and rollouts up to the end of the first
  iteration with a valid candidate. They are 0 and 1 if the initial layout is valid.
- `seconds`: time of the search without compilation. Runs in one computation have equal shares of
  its time.
"""

ITERATION_COLUMNS: dict[str, type] = {
    **KEYS,
    "iteration": int,
    "rollouts": int,
    "best": float,
    "merit": float,
    "mean": float,
    "valid": float,
    **_TERMS,
}
"""Columns of an iteration.

- `iteration`: number of the iteration, counted from 1.
- `rollouts`: number of rollouts so far.
- `best`: best absolute reward so far.
- `merit`: largest merit of a valid candidate so far.
- `mean`: mean absolute reward of the candidates that did not fail.
- `valid`: fraction of the candidates that are valid.
- The terms, and a column for each further reward term: values of the iteration's best candidate.
"""


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
        **_first_valid_columns(refined.first_valid),
        "seconds": refined.seconds["search"],
        "to_valid_s": None if np.isnan(to_valid) else to_valid,
        "engine": refined.engine,
        **_value_columns(values, refined.delivered, history["term_names"]),
        **_scene_columns(case, model, refined.layout, refined.scene, refined.measure),
    }


def row_of_search(
    case: Case,
    model: SceneModel,
    result: SearchResult,
    winner: Winner,
    delivered: Mapping[str, float],
) -> Row:
    """Return the columns of one run of a search. The caller adds the times and the engine.

    Args:
        case: the scene.
        model: the compiled scene.
        result: the search.
        winner: the winner of the search.
        delivered: scores of the winner's final scene; see `delivery.final_scene_scores`.
    """
    t, k = winner.index
    values = None
    if t >= 0:
        scores = result.rounds[t].scores
        values = {name: x[k] for name, x in scores.terms.items()}
        values |= {"valid": scores.valid[k], "absolute": scores.absolute[k]}
        values |= {"merit": scores.merit[k]}
    return {
        "passed": winner.passed,
        "iterations": len(result.rounds),
        "rollouts": result.rollouts,
        **_first_valid_columns(result.first_valid),
        **_value_columns(values, delivered, [term.name for term in result.problem.objective.terms]),
        **_scene_columns(case, model, winner.layout, winner.scene, winner.measure),
    }


def _first_valid_columns(first: TimeToValid | None) -> Row:
    return {
        "iterations_to_valid": None if first is None else first.iteration,
        "rollouts_to_valid": None if first is None else first.rollouts,
    }


def _value_columns(
    candidate: Mapping[str, Any] | None, delivered: Mapping[str, float], terms: Iterable[Any]
) -> Row:
    """Return the scores of the delivered scene and of the winning candidate; None if not finite."""
    columns = {"reward": "absolute", "merit": "merit"}
    columns |= {TERM_COLUMNS.get(name, TERM + name): name for name in map(str, terms)}
    row: Row = {"valid": candidate is not None and bool(candidate["valid"])}
    for prefix, values in (("", delivered), (CANDIDATE, candidate or {})):
        for column, name in columns.items():
            value = float(values.get(name, np.nan))
            row[prefix + column] = value if np.isfinite(value) else None
    return row


def _scene_columns(
    case: Case, model: SceneModel, layout: Layout, scene: SceneSpec, measure: SceneMeasure
) -> Row:
    log_scales = np.asarray(layout.log_scale[0])[np.asarray(model.optimised)]
    errors = case.errors(scene) if case.errors is not None else {}
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
    names = ("absolute", "merit", "valid", "status", *terms)
    return [
        iteration_summary({name: history[name][t] for name in names}, terms)
        for t in range(len(history["absolute"]))
    ]


def iteration_rows(steps: Sequence[Row]) -> list[Row]:
    """Return the rows of a run's iterations, without the columns KEYS, from their summaries."""
    rows: list[Row] = []
    so_far: Row = {"best": None, "merit": None}
    rollouts = 0
    for t, step in enumerate(steps, start=1):
        rollouts += step["rollouts"]
        for name, value in so_far.items():
            values = [x for x in (value, step[name]) if x is not None]
            so_far[name] = max(values, default=None)
        columns = {TERM_COLUMNS.get(name, name): value for name, value in step.items()}
        rows.append({"iteration": t, **columns, **so_far, "rollouts": rollouts})
    return rows


def term_columns(rows: Sequence[Row]) -> list[str]:
    """Return the columns of the reward terms that not every run has, in their order in the rows."""
    prefixes = (TERM, CANDIDATE + TERM)
    return list(dict.fromkeys(name for row in rows for name in row if name.startswith(prefixes)))


def write_runs(path: Path, rows: Sequence[Row], values: Sequence[str]) -> None:
    """Write runs to a Parquet file.

    Args:
        path: the file.
        rows: rows of the runs.
        values: columns that distinguish points.

    Raises:
        RunError: the file cannot be written.
    """
    column_types = KEYS | {name: _column_type([row.get(name) for row in rows]) for name in values}
    _write(path, rows, column_types | COLUMNS | dict.fromkeys(term_columns(rows), float))


def write_iterations(path: Path, rows: Sequence[Row]) -> None:
    """Write the iterations of runs, which each row has under "history", to a Parquet file.

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
    """Return runs to which their iterations are added under "history".

    The iterations are read from a Parquet file. If the file is missing, they are empty.

    Raises:
        RunError: the file cannot be read.
    """
    histories: dict[Key, list[Row]] = {row_key(row): [] for row in rows}
    if path.exists():
        for step in parquet_files.read_rows(path, tuple(ITERATION_COLUMNS), RunError):
            columns = {name: value for name, value in step.items() if name not in KEYS}
            histories.setdefault(row_key(step), []).append(columns)
    return [row | {"history": histories[row_key(row)]} for row in rows]


def _write(path: Path, rows: Sequence[Row], column_types: Mapping[str, type]) -> None:
    cells = [
        {name: _cell(row.get(name), kind) for name, kind in column_types.items()} for row in rows
    ]
    parquet_files.write_rows(path, cells, column_types, RunError)


def _column_type(values: Sequence[Any]) -> type:
    """Return the type of a column that can contain all values of an axis."""
    types = {type(plain_value(value)) for value in values if value is not None}
    if types == {int, float}:
        return float
    return types.pop() if len(types) == 1 else str


def _cell(value: Any, kind: type) -> Any:
    if value is None:
        return None
    return kind(plain_value(value) if kind is str else value)

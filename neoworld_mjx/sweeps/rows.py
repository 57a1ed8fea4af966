"""Results of single runs, and the Parquet file that holds them."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import arro3.io
import numpy as np
from arro3.core import Array, DataType, Table

from ..errors import RunError
from ..files import write_atomic
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..refinement.outcome import Chosen, Refined
from .cases import Case
from .fold import Searched
from .plan import plain

Row = dict[str, Any]
"""One run: scene, point, seed, what sets the point apart, and what came of it."""

COLUMNS: dict[str, type] = {
    "valid": bool,
    "passed": bool,
    "reward": float,
    "d_pen_m": float,
    "d_drift": float,
    "s_sem": float,
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
    "seconds": float,
    "to_valid_s": float,
    "engine": str,
    "fingerprint": str,
}
"""What is known of a run; absent where it does not apply. `valid` is of the search, `passed` of the
exact check; `reward` is the absolute one, of the winner, as are the terms. `seconds` is the time of
the search: of runs in one computation an equal share, compiling included. Depth, drift and tilt are of the check."""


def row_of_refined(case: Case, model: SceneModel, found: Refined) -> Row:
    """Describe the outcome of a refinement by itself."""
    t, k = found.winner
    at = lambda name: found.history[name][t, k] if t >= 0 else None
    to_valid = found.seconds["to_valid"]
    return _row(
        {
            "valid": bool(t >= 0 and at("valid")),
            "passed": found.passed,
            "reward": at("absolute"),
            "d_pen_m": at("d_pen"),
            "d_drift": at("d_drift"),
            "s_sem": at("s_sem"),
            "iterations": found.iterations,
            "rollouts": found.rollouts,
            "pruned": found.pruned,
            "seconds": found.seconds["search"],
            "to_valid_s": None if np.isnan(to_valid) else to_valid,
            "engine": found.engine,
        },
        (case, model, found.layout),
        found.measure,
    )


def row_of_searched(
    case: Case, model: SceneModel, found: Searched, chosen: Chosen, start: Layout | None
) -> Row:
    """Describe the outcome of a run among others; the caller adds time and engine."""
    t, k = chosen.index
    if t >= 0:
        layouts, _, scores = found.rounds[t]
        layout = Layout(layouts.xy[k : k + 1], layouts.yaw[k : k + 1], layouts.log_scale[k : k + 1])
        at = lambda name: getattr(scores, name)[k]
    else:
        layout = start or Layout.zero(1, len(model.names))
        at = lambda name: None
    return _row(
        {
            "valid": bool(t >= 0 and at("valid")),
            "passed": chosen.passed,
            "reward": at("absolute"),
            "d_pen_m": at("d_pen"),
            "d_drift": at("d_drift"),
            "s_sem": at("s_sem"),
            "iterations": found.iterations,
            "rollouts": found.rollouts,
            "pruned": 0,
        },
        (case, model, layout),
        chosen.measure,
    )


def _row(known: Row, of: tuple[Case, SceneModel, Layout], measure: Any) -> Row:
    case, model, layout = of
    moves = np.asarray(model.optimised)
    logs = np.asarray(layout.log_scale[0])[moves]
    off = case.errors(model, layout) if case.errors is not None else {}
    return known | {
        "mean_log_scale": float(logs.mean()) if len(logs) else 0.0,
        "max_depth_m": measure.max_depth_m,
        "max_drift_m": measure.max_drift_m,
        "max_tilt_deg": measure.max_tilt_deg,
        "xy_error_m": off.get("xy_m"),
        "yaw_error_deg": off.get("yaw_deg"),
        "scale_error": off.get("scale"),
    }


_TYPES: dict[type, Any] = {
    bool: DataType.bool(),
    int: DataType.int64(),
    float: DataType.float64(),
    str: DataType.utf8(),
}


def write_parquet(path: Path, rows: Sequence[Row], values: Sequence[str]) -> None:
    """Write rows, replacing the file at once.

    Args:
        path: of the file.
        rows: the runs.
        values: columns that tell points apart.

    Raises:
        RunError: the file cannot be written.
    """
    kinds: dict[str, type] = {"scene": str, "point": str, "seed": int}
    kinds |= {name: _kind([row.get(name) for row in rows]) for name in values}
    kinds |= COLUMNS
    table = Table.from_pydict(
        {
            name: Array([_cell(row.get(name), kind) for row in rows], type=_TYPES[kind])
            for name, kind in kinds.items()
        }
    )
    data = io.BytesIO()
    arro3.io.write_parquet(table, data, compression="zstd(3)")
    try:
        write_atomic(path, data.getvalue())
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None


def read_parquet(path: Path) -> list[Row]:
    """Read rows back.

    Raises:
        RunError: the file cannot be read, or is no Parquet file.
    """
    try:
        data = path.read_bytes()
        # The reader ends the process's thread on other files, so they are told apart first.
        if data[:4] != b"PAR1" or data[-4:] != b"PAR1":
            raise RunError(f"{path} is not a Parquet file")
        table = arro3.io.read_parquet(path).read_all()
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror}") from None
    columns = [column.to_pylist() for column in table.columns]
    rows = zip(*columns, strict=True)
    return [dict(zip(table.column_names, row, strict=True)) for row in rows]


def _kind(values: Sequence[Any]) -> type:
    """Return the one type that holds all values of an axis."""
    found = {type(plain(value)) for value in values if value is not None}
    if found == {int, float}:
        return float
    return found.pop() if len(found) == 1 else str


def _cell(value: Any, kind: type) -> Any:
    if value is None:
        return None
    return kind(plain(value) if kind is str else value)


Key = tuple[str, str, int]


def key(row: Mapping[str, Any]) -> Key:
    """Return what a row is found by: scene, point and seed."""
    return row["scene"], row["point"], row["seed"]

"""Iterations of a sweep's runs: one tidy row each, in histories.parquet."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..refinement.outcome import iteration_summary
from .run_rows import TERM_COLUMNS, Row, key, read_rows, write_rows

HISTORIES = "histories.parquet"
COLUMNS: dict[str, type] = {
    "scene": str,
    "point": str,
    "seed": int,
    "iteration": int,
    "best": float,
    "mean": float,
    "valid": float,
    "d_pen_m": float,
    "d_drift": float,
    "s_sem": float,
    "prior": float,
}
"""Columns of an iteration, counted from 1: the best absolute reward so far, the mean of those that
have one, the share of valid candidates among all drawn, and the terms of the iteration's best.
Further columns are reward terms of the user's own."""


def summaries(history: Mapping[str, np.ndarray]) -> list[Row]:
    """Sum up the iterations of a refinement's history; see `iteration_summary`."""
    terms = [str(name) for name in history["term_names"]]
    needed = ("absolute", "valid", "status", *terms)
    return [
        iteration_summary({name: history[name][t] for name in needed}, terms)
        for t in range(len(history["absolute"]))
    ]


def so_far(steps: Sequence[Row]) -> list[Row]:
    """Return rows of a run's iterations, without scene, point and seed, from their summaries."""
    rows: list[Row] = []
    best = -np.inf
    for t, step in enumerate(steps, start=1):
        best = best if step["best"] is None else max(best, step["best"])
        columns = {TERM_COLUMNS.get(name, name): value for name, value in step.items()}
        rows.append({"iteration": t, **columns, "best": best if np.isfinite(best) else None})
    return rows


def write_histories(path: Path, rows: Sequence[Row]) -> None:
    """Write the iterations of some runs.

    Args:
        path: of the file.
        rows: the runs; the iterations of each are under "history".

    Raises:
        RunError: the file cannot be written.
    """
    tidy = [
        {"scene": row["scene"], "point": row["point"], "seed": row["seed"], **step}
        for row in rows
        for step in row.get("history", ())
    ]
    own_terms = dict.fromkeys(
        (name for step in tidy for name in step if name not in COLUMNS), float
    )
    write_rows(path, tidy, COLUMNS | own_terms)


def with_histories(path: Path, rows: Sequence[Row]) -> list[Row]:
    """Return runs with the iterations that an earlier part of the sweep wrote.

    Raises:
        RunError: the file cannot be read.
    """
    steps: dict[Any, list[Row]] = {}
    for step in read_rows(path, COLUMNS) if path.exists() else ():
        run = key(step)
        steps.setdefault(run, []).append(
            {name: v for name, v in step.items() if name not in ("scene", "point", "seed")}
        )
    return [row | {"history": steps.get(key(row), [])} for row in rows]

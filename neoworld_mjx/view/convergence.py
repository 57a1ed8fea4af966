"""How the search of Step 5 went, drawn from refine/history.npz."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import charts
from .charts import Band, Line
from .page import Html, missing, section, table


def convergence(path: Path) -> Html:
    """Draw rewards, terms and the share of valid candidates over iterations.

    Args:
        path: history.npz with `absolute`, `d_pen`, `d_drift`, `s_sem`, `valid`, `status`, all of
            shape [iteration, candidate], and `log_scale` [iteration, candidate, object].
    """
    title = "Convergence of the search"
    try:
        with np.load(path) as data:
            history = {key: data[key] for key in data.files}
    except FileNotFoundError:
        return section(title, missing("No refine/history.npz yet."))
    except (OSError, ValueError, zipfile.BadZipFile):
        return section(title, missing("refine/history.npz cannot be read."))
    absolute = history.get("absolute")
    if absolute is None or absolute.ndim != 2 or absolute.size == 0:
        return section(title, missing("refine/history.npz holds no rewards."))
    drawn = [_rewards(absolute), _valid(history)]
    drawn += [_term(history, key, label) for key, label in _TERMS if key in history]
    body = f'<div class="charts">{"".join(drawn)}</div>'
    return section(title, body, _table(history))


PRUNED, NOT_DRAWN = 5, -1
"""Statuses in the history of what was not rolled out, and of places that stayed empty."""

_TERMS = (
    ("d_pen", "D_pen (sum over pairs), mm"),
    ("d_drift", "D_drift (sum), stability bounds"),
    ("s_sem", "S_sem"),
)


def _finite(values: NDArray) -> NDArray:
    """Turn values that are not finite (failed candidates) into NaN."""
    values = np.asarray(values, float)
    return np.where(np.isfinite(values), values, np.nan)


def _over(values: NDArray, function: Any) -> NDArray:
    """Apply a reduction to the finite candidates of each iteration; NaN where there are none."""
    rows = [row[np.isfinite(row)] for row in _finite(values)]
    return np.array([float(function(row)) if row.size else np.nan for row in rows])


def _rewards(absolute: NDArray) -> str:
    best = _over(absolute, np.max)
    so_far = np.fmax.accumulate(best)
    return charts.line_chart(
        [
            Line("best so far", so_far, "var(--c3)", dashed=True),
            Line("best", best, "var(--c1)"),
            Line("mean", _over(absolute, np.mean), "var(--c2)"),
        ],
        band=Band(
            "middle 80 %",
            _over(absolute, lambda row: np.quantile(row, 0.1)),
            _over(absolute, lambda row: np.quantile(row, 0.9)),
        ),
        y_label="absolute reward",
    )


def _valid(history: dict[str, NDArray]) -> str:
    if "valid" not in history:
        return str(missing("history.npz does not say which candidates are valid."))
    drawn, pruned = _counts(history)
    rolled = np.maximum(drawn - pruned, 1)
    lines = [
        Line("valid of those rolled out", 100.0 * history["valid"].sum(1) / rolled, "var(--c3)")
    ]
    if pruned.any():
        lines.append(
            Line("pruned", 100.0 * pruned / np.maximum(drawn, 1), "var(--c2)", dashed=True)
        )
    return charts.line_chart(lines, y_label="candidates, %", limits=(0.0, 100.0))


def _counts(history: dict[str, NDArray]) -> tuple[NDArray, NDArray]:
    """Return how many candidates of each iteration were drawn, and how many of them pruned."""
    status = history.get("status")
    if status is None:
        iterations, population = history["absolute"].shape
        return np.full(iterations, population), np.zeros(iterations, int)
    return np.sum(status != NOT_DRAWN, axis=1), np.sum(status == PRUNED, axis=1)


def _term(history: dict[str, NDArray], key: str, label: str) -> str:
    values = np.asarray(history[key], float) * (1000.0 if key == "d_pen" else 1.0)
    best = np.where(np.isfinite(history["absolute"]), history["absolute"], -np.inf).argmax(axis=1)
    chosen = np.take_along_axis(values, best[:, None], axis=1)[:, 0]
    return charts.line_chart(
        [
            Line("candidate of best reward", chosen, "var(--c1)"),
            Line("mean", _over(values, np.mean), "var(--c2)"),
        ],
        y_label=label,
    )


def _table(history: dict[str, NDArray]) -> Html:
    absolute = history["absolute"]
    best, mean = _over(absolute, np.max), _over(absolute, np.mean)
    drawn, pruned = _counts(history)
    failed = drawn - pruned - np.sum(np.isfinite(absolute), axis=1)
    heads = ["#iteration", "#best", "#mean", "#drawn", "#pruned", "#valid", "#failed"]
    heads.append("#mean log scale")
    rows = []
    for i in range(len(absolute)):
        valid = f"{int(np.sum(history['valid'][i]))}" if "valid" in history else ""
        scale = ""
        if "log_scale" in history:
            scale = f"{float(np.nanmean(history['log_scale'][i])):+.4f}"
        counts = [drawn[i], pruned[i], valid, failed[i]]
        rows.append([i + 1, f"{best[i]:.4f}", f"{mean[i]:.4f}", *counts, scale])
    return table(heads, rows)

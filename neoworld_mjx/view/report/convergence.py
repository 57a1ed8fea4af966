"""Convergence of the search of Step 5, drawn from refine/history.npz."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import RunError
from ...io import read_arrays
from . import charts
from .charts import Band, Series
from .page import Html, missing, section, table

TERMS = ("d_pen", "d_drift", "s_sem", "prior")
"""Reward terms of runs whose history does not name them."""
LABELS = {
    "d_pen": ("D_pen, mm", 1000.0),
    "d_drift": ("D_drift, bounds", 1.0),
    "s_sem": ("S_sem", 1.0),
    "prior": ("prior, sigma²", 1.0),
}
"""Label and unit of the built-in terms, and the factor to that unit."""


def convergence(path: Path) -> Html:
    """Draw rewards, terms and the share of valid candidates over iterations.

    Args:
        path: history.npz with `absolute`, `valid`, `status` and an array under each of
            `term_names`, all [iteration, candidate], `term_weights` [term], and `log_scale`
            [iteration, candidate, object].
    """
    title = "Convergence of the search"
    if not path.exists():
        return section(title, missing("No refine/history.npz yet."))
    try:
        history = read_arrays(path, RunError)
    except RunError as error:
        return section(title, missing(f"refine/history.npz cannot be read: {error}"))
    absolute = history.get("absolute")
    if absolute is None or absolute.ndim != 2 or absolute.size == 0:
        return section(title, missing("refine/history.npz holds no rewards."))
    drawn = [_rewards(absolute), _valid(history)]
    drawn += [_term(history, term) for term in term_histories(history)]
    body = f'<div class="charts">{"".join(drawn)}</div>'
    return section(title, body, _table(history))


PRUNED, NOT_DRAWN = 5, -1
"""Statuses in the history of pruned candidates, and of the places of candidates not drawn."""


class TermHistory(NamedTuple):
    """A reward term in the history."""

    name: str
    label: str
    values: NDArray
    """In the unit of its label, [iteration, candidate]."""


def term_histories(history: Mapping[str, NDArray]) -> list[TermHistory]:
    """Return the reward terms that a history holds."""
    names = [str(name) for name in history.get("term_names", TERMS)]
    weights = history.get("term_weights", np.full(len(names), np.nan))
    terms = []
    for name, weight in zip(names, weights, strict=True):
        if name in history:
            label, factor = LABELS.get(name, (name, 1.0))
            weighted = f"{label}, weight {weight:g}" if np.isfinite(weight) else label
            terms.append(TermHistory(name, weighted, np.asarray(history[name], float) * factor))
    return terms


def best_candidates(history: Mapping[str, NDArray]) -> NDArray:
    """Return the index of the candidate of best reward of each iteration [iteration]."""
    absolute = history["absolute"]
    return np.where(np.isfinite(absolute), absolute, -np.inf).argmax(axis=1)


def _finite(values: NDArray) -> NDArray:
    """Turn values that are not finite (failed candidates) into NaN."""
    values = np.asarray(values, float)
    return np.where(np.isfinite(values), values, np.nan)


def over_finite(values: NDArray, function: Any) -> NDArray:
    """Apply a reduction to the finite candidates of each iteration; NaN where there are none."""
    rows = [row[np.isfinite(row)] for row in _finite(values)]
    return np.array([float(function(row)) if row.size else np.nan for row in rows])


def _rewards(absolute: NDArray) -> str:
    best = over_finite(absolute, np.max)
    so_far = np.fmax.accumulate(best)
    return charts.line_chart(
        [
            Series("best so far", so_far, "var(--c3)", dashed=True),
            Series("best", best, "var(--c1)"),
            Series("mean", over_finite(absolute, np.mean), "var(--c2)"),
        ],
        band=Band(
            "middle 80 %",
            over_finite(absolute, lambda row: np.quantile(row, 0.1)),
            over_finite(absolute, lambda row: np.quantile(row, 0.9)),
        ),
        y_label="absolute reward",
    )


def _valid(history: dict[str, NDArray]) -> str:
    if "valid" not in history:
        return str(missing("history.npz does not say which candidates are valid."))
    drawn, pruned = _counts(history)
    rolled = np.maximum(drawn - pruned, 1)
    lines = [
        Series("valid of those rolled out", 100.0 * history["valid"].sum(1) / rolled, "var(--c3)")
    ]
    if pruned.any():
        lines.append(
            Series("pruned", 100.0 * pruned / np.maximum(drawn, 1), "var(--c2)", dashed=True)
        )
    return charts.line_chart(lines, y_label="candidates, %", limits=(0.0, 100.0))


def _counts(history: dict[str, NDArray]) -> tuple[NDArray, NDArray]:
    """Return how many candidates of each iteration were drawn, and how many of them pruned."""
    status = history.get("status")
    if status is None:
        iterations, population = history["absolute"].shape
        return np.full(iterations, population), np.zeros(iterations, int)
    return np.sum(status != NOT_DRAWN, axis=1), np.sum(status == PRUNED, axis=1)


def _term(history: dict[str, NDArray], term: TermHistory) -> str:
    chosen = np.take_along_axis(term.values, best_candidates(history)[:, None], axis=1)[:, 0]
    return charts.line_chart(
        [
            Series("candidate of best reward", chosen, "var(--c1)"),
            Series("mean", over_finite(term.values, np.mean), "var(--c2)"),
        ],
        y_label=term.label,
    )


def _table(history: dict[str, NDArray]) -> Html:
    absolute = history["absolute"]
    best, mean = over_finite(absolute, np.max), over_finite(absolute, np.mean)
    drawn, pruned = _counts(history)
    failed = drawn - pruned - np.sum(np.isfinite(absolute), axis=1)
    heads = ["#iteration", "#best", "#mean", "#drawn", "#pruned", "#valid", "#failed"]
    terms, chosen = term_histories(history), best_candidates(history)
    heads += ["#mean log scale", *(f"#{term.name} of best" for term in terms)]
    rows = []
    for i in range(len(absolute)):
        valid = f"{int(np.sum(history['valid'][i]))}" if "valid" in history else ""
        scale = ""
        if "log_scale" in history:
            scale = f"{float(np.nanmean(history['log_scale'][i])):+.4f}"
        counts = [drawn[i], pruned[i], valid, failed[i]]
        values = [f"{term.values[i, chosen[i]]:.4g}" for term in terms]
        rows.append([i + 1, f"{best[i]:.4f}", f"{mean[i]:.4f}", *counts, scale, *values])
    return table(heads, rows)

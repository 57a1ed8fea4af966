"""Charts of the convergence of the search in Step 5, from refine/history.npz."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from ...errors import RunError
from ...io import read_arrays
from .charts import Band, Series, line_chart
from .page import elements

TITLE = "Convergence of the search"
TERMS = ("d_pen", "d_drift", "s_sem", "prior")
"""Reward terms of a history without the array `term_names`."""
LABELS = {
    "d_pen": ("D_pen, mm", 1000.0),
    "d_drift": ("D_drift, bounds", 1.0),
    "s_sem": ("S_sem", 1.0),
    "prior": ("prior, sigma²", 1.0),
}
"""Label with unit for each built-in term, and the factor that converts values to this unit."""
NOT_SAMPLED = -1
"""Status of an entry of the arrays for which no candidate was sampled."""

History = Mapping[str, NDArray]


class TermHistory(NamedTuple):
    """Values of a reward term for all candidates."""

    name: str
    weight: float
    """Weight of the term; NaN if the history does not contain weights."""
    raw: NDArray
    """Values as stored in the history, shape [iteration, candidate]."""

    @property
    def label(self) -> str:
        """Label with the unit and, if known, the weight."""
        label, _ = LABELS.get(self.name, (self.name, 1.0))
        return f"{label}, weight {self.weight:g}" if np.isfinite(self.weight) else label

    @property
    def values(self) -> NDArray:
        """Values in the unit of the label, shape [iteration, candidate]."""
        return self.raw * LABELS.get(self.name, ("", 1.0))[1]


def convergence(path: Path) -> Markup:
    """Return the section with rewards, terms and the fraction of valid candidates over iterations.

    Args:
        path: history.npz, with the arrays `absolute`, `valid` and `status` and an array for each
            name in `term_names`, all of shape [iteration, candidate], `term_weights` [term], and
            `log_scale` [iteration, candidate, object].
    """
    if not path.exists():
        return elements.section(TITLE, elements.missing("No refine/history.npz yet."))
    try:
        history = read_arrays(path, RunError)
    except RunError as error:
        note = f"refine/history.npz cannot be read: {error}"
        return elements.section(TITLE, elements.missing(note))
    absolute = history.get("absolute")
    if absolute is None or absolute.ndim != 2 or absolute.size == 0:
        return elements.section(TITLE, elements.missing("refine/history.npz contains no rewards."))
    terms, best = term_histories(history), best_candidates(history)
    charts = [_reward_chart(absolute), _valid_chart(history)]
    charts += [_term_chart(term, best) for term in terms]
    return elements.section(TITLE, elements.div("charts", *charts), _table(history, terms, best))


def term_histories(history: History) -> list[TermHistory]:
    """Return the reward terms that a history contains."""
    names = [str(name) for name in history.get("term_names", TERMS)]
    weights = history.get("term_weights", np.full(len(names), np.nan))
    return [
        TermHistory(name, float(weight), np.asarray(history[name], float))
        for name, weight in zip(names, weights, strict=True)
        if name in history
    ]


def best_candidates(history: History) -> NDArray:
    """Return the index of the candidate with the highest reward, for each iteration."""
    absolute = history["absolute"]
    return np.where(np.isfinite(absolute), absolute, -np.inf).argmax(axis=1)


def over_finite(values: ArrayLike, function: Callable[[NDArray], Any]) -> NDArray:
    """Reduce the finite values of each iteration to one number, or NaN if there are none."""
    rows = [row[np.isfinite(row)] for row in np.asarray(values, float)]
    return np.array([float(function(row)) if row.size else np.nan for row in rows])


def _reward_chart(absolute: NDArray) -> Markup:
    best = over_finite(absolute, np.max)
    return line_chart(
        [
            Series("best so far", np.fmax.accumulate(best), "var(--c3)", dashed=True),
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


def _valid_chart(history: History) -> Markup:
    if "valid" not in history:
        return elements.missing("history.npz does not state which candidates are valid.")
    valid = 100.0 * history["valid"].sum(1) / np.maximum(_sampled(history), 1)
    lines = [Series("valid", valid, "var(--c3)")]
    return line_chart(lines, y_label="candidates, %", limits=(0.0, 100.0))


def _term_chart(term: TermHistory, best: NDArray) -> Markup:
    chosen = np.take_along_axis(term.values, best[:, None], axis=1)[:, 0]
    mean = Series("mean", over_finite(term.values, np.mean), "var(--c2)")
    return line_chart([Series("candidate of best reward", chosen), mean], y_label=term.label)


def _sampled(history: History) -> NDArray:
    """Return the number of sampled candidates in each iteration."""
    status = history.get("status")
    if status is None:
        iterations, population = history["absolute"].shape
        return np.full(iterations, population)
    return np.sum(status != NOT_SAMPLED, axis=1)


def _table(history: History, terms: list[TermHistory], chosen: NDArray) -> Markup:
    absolute = history["absolute"]
    best, mean = over_finite(absolute, np.max), over_finite(absolute, np.mean)
    sampled = _sampled(history)
    failed = sampled - np.sum(np.isfinite(absolute), axis=1)
    heads = ["#iteration", "#best", "#mean", "#sampled", "#valid", "#failed"]
    heads += ["#mean log scale", *(f"#{term.name} of best" for term in terms)]
    rows = []
    for i in range(len(absolute)):
        valid = int(np.sum(history["valid"][i])) if "valid" in history else ""
        scale = f"{np.nanmean(history['log_scale'][i]):+.4f}" if "log_scale" in history else ""
        counts = [sampled[i], valid, failed[i]]
        values = [f"{term.values[i, chosen[i]]:.4g}" for term in terms]
        rows.append([i + 1, f"{best[i]:.4f}", f"{mean[i]:.4f}", *counts, scale, *values])
    return elements.table(heads, rows)

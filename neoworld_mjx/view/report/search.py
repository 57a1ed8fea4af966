"""Table of the iterations of the search in Step 5, from refine/history.npz."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from ...errors import RunError
from ...io import read_arrays
from .page import elements

TITLE = "Convergence of the search"
_NOTE = "Terms are those of the candidate with the best reward, in SI units, with their weights."


def convergence(path: Path) -> Markup:
    """Return the section with rewards, terms and numbers of candidates by iteration.

    Args:
        path: history.npz, with the arrays `reward`, `valid` and `status` and an array for each
            name in `term_names`, all of shape [iteration, candidate], and `term_weights` [term].
    """
    if not path.exists():
        return elements.section(TITLE, elements.missing("No refine/history.npz yet."))
    try:
        history = read_arrays(path, RunError)
    except RunError as error:
        note = f"refine/history.npz cannot be read: {error}"
        return elements.section(TITLE, elements.missing(note))
    reward = history["reward"]
    if not len(reward):
        note = "The composed scene was accepted; no search was needed."
        return elements.section(TITLE, elements.paragraph(note))
    names = [str(name) for name in history["term_names"]]
    valid = np.sum(history["valid"], axis=1)
    failed = np.sum(~np.isfinite(reward), axis=1)
    best, mean = _over_finite(reward, np.max), _over_finite(reward, np.mean)
    chosen = np.where(np.isfinite(reward), reward, -np.inf).argmax(axis=1)
    rows = [
        [
            *(t + 1, f"{best[t]:.4f}", f"{mean[t]:.4f}", reward.shape[1], valid[t], failed[t]),
            *(f"{history[name][t, chosen[t]]:.4g}" for name in names),
        ]
        for t in range(len(reward))
    ]
    heads = ["#iteration", "#best reward", "#mean reward", "#sampled", "#valid", "#failed"]
    weights = history["term_weights"]
    heads += [f"#{name} × {weight:g}" for name, weight in zip(names, weights, strict=True)]
    return elements.section(TITLE, elements.table(heads, rows), elements.paragraph(_NOTE, "dim"))


def _over_finite(values: ArrayLike, function: Callable[[NDArray], Any]) -> NDArray:
    """Reduce the finite values of each iteration to one number, or NaN if there are none."""
    rows = [row[np.isfinite(row)] for row in np.asarray(values, float)]
    return np.array([float(function(row)) if row.size else np.nan for row in rows])

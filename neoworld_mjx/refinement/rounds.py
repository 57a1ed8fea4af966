"""Iterations of a search, and the ranking of their candidates."""

from typing import Any, NamedTuple

import numpy as np

from ..physics.layout import Layout, Poses
from .objective import Scores

NOT_SAMPLED = -1
"""Status in the history of entries beyond the population of an iteration, which pad it."""


class Round(NamedTuple):
    """One iteration of one run, without padded objects."""

    layouts: Layout
    poses: Poses
    """Poses of the candidates: settled poses if settling is enabled, else placed poses."""
    scores: Scores


def rank_candidates(rounds: list[Round]) -> list[tuple[tuple[int, int], float]]:
    """Rank the candidates of all iterations.

    Valid candidates come first and are ranked by merit. All others are ranked by absolute reward.

    Returns:
        ((iteration, candidate), absolute reward) of every candidate, best first.
    """
    if not rounds:
        return []
    valid = stack_padded([r.scores.valid for r in rounds], False)
    absolute = stack_padded([r.scores.absolute for r in rounds], -np.inf)
    merit = stack_padded([r.scores.merit for r in rounds], -np.inf)
    pop = valid.shape[1]
    order = best_first(valid.ravel(), merit.ravel(), absolute.ravel())
    return [(divmod(int(k), pop), float(absolute.flat[k])) for k in order]


def best_first(valid: np.ndarray, merit: np.ndarray, absolute: np.ndarray) -> np.ndarray:
    """Return the candidates' indices in the order of `rank_candidates`, best first; [pop]."""
    return np.lexsort((-np.where(valid, merit, absolute), ~valid))


def stack_padded(rows: list[Any], fill: Any) -> np.ndarray:
    """Stack iterations, padding each of them to the largest population with `fill`."""
    largest = np.asarray(max(rows, key=len))
    padded = np.full((len(rows), *largest.shape), fill, largest.dtype)
    for t, row in enumerate(rows):
        padded[t, : len(row)] = row
    return padded

"""Iterations of a search, and the order in which their candidates are tried."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool

from ..physics.layout import Layout, Poses
from .objective import Scores

NOT_DRAWN = -1
"""Status, in the history, of entries beyond the population of an iteration."""


class Round(NamedTuple):
    """An iteration of one run."""

    layouts: Layout
    poses: Poses
    """Where the candidates were placed."""
    scores: Scores
    rests: Bool[np.ndarray, " pop"]
    """Whether the poses are those at which the candidates came to rest."""

    def of_objects(self, count: int) -> "Round":
        """Leave padded objects out of the layouts and poses."""
        own = lambda tree: jax.tree.map(lambda x: np.asarray(x)[:, :count], tree)
        s = self.scores
        scores = eqx.tree_at(
            lambda s: (s.drift, s.depth), s, (s.drift[:, :count], s.depth[:, :count])
        )
        return Round(own(self.layouts), own(self.poses), scores, self.rests)


def ranked(rounds: list[Round]) -> list[tuple[tuple[int, int], float]]:
    """Order all candidates: valid ones first, by fidelity, then the others, by absolute reward.

    Returns:
        ((iteration, candidate), absolute reward) of each.
    """
    valid = stacked([r.scores.valid for r in rounds], False)
    absolute = stacked([r.scores.absolute for r in rounds], -np.inf)
    fidelity = stacked([r.scores.fidelity for r in rounds], -np.inf)
    pop = valid.shape[1]
    order = best_first(valid.ravel(), fidelity.ravel(), absolute.ravel())
    return [(divmod(int(k), pop), float(absolute.flat[k])) for k in order]


def best_first(valid: np.ndarray, fidelity: np.ndarray, absolute: np.ndarray) -> np.ndarray:
    """Return the indices of candidates [pop] in the order in which they are tried; see `ranked`."""
    return np.lexsort((-np.where(valid, fidelity, absolute), ~valid))


def stacked(rows: list[Any], fill: Any) -> np.ndarray:
    """Stack iterations; fill shorter ones up to the largest population."""
    full = np.asarray(max(rows, key=len))
    stacked = np.full((len(rows), *full.shape), fill, full.dtype)
    for t, row in enumerate(rows):
        stacked[t, : len(row)] = row
    return stacked

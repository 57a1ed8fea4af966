"""Exact pruning: candidates that cannot become elites are not rolled out.

With `fixed` normalisation, a rollout can only lower a reward whose terms all have a bound.
Candidates are rolled out in decreasing order of their bounds, until the next bound is below the
K-th best reward so far: no later candidate can be among the K best.
"""

import numpy as np

from ..physics.engine import RolloutStatus
from .objective import Placement, Scores

PRUNED = len(RolloutStatus)
"""Status, in `Scores`, of a candidate that was not rolled out."""


class RolloutPlan:
    """Order in which the candidates of a population are settled and rolled out, and their scores.

    If candidates are settled before they are scored, they are settled in batches, in decreasing
    order of their bounds, until one is valid.

    Args:
        placement: the candidates, with the upper bounds of their rewards.
        batch: number of candidates rolled out at once; None rolls out all and prunes none.
        elites: K.
        until_valid: True to prune nothing until a candidate is valid.
        seen_valid: True if a candidate of an earlier iteration was valid.
        rests: number of candidates settled at once; 0 settles none.
    """

    def __init__(
        self,
        placement: Placement,
        *,
        batch: int | None,
        elites: int,
        until_valid: bool = False,
        seen_valid: bool = False,
        rests: int = 0,
    ) -> None:
        self._placement = placement
        self._upper = np.asarray(placement.bound)
        order = np.argsort(-self._upper, kind="stable")
        self._order, self._waiting = (order[:0], order) if rests else (order, order[:0])
        self._prunes = batch is not None
        self._batch = batch or rests or None
        self.rests, self._until_valid, self._seen_valid = rests, until_valid, seen_valid
        self._best = np.full(elites, -np.inf)
        self._first = 0
        self._parts: list[tuple[np.ndarray, Scores]] = []

    @property
    def rolled_out(self) -> int:
        """Number of candidates that were rolled out."""
        return sum(len(rows) for rows, _ in self._parts)

    @property
    def ready(self) -> np.ndarray:
        """Candidates that may be rolled out: all, or those that have settled."""
        return np.sort(self._order)

    def waiting(self) -> np.ndarray | None:
        """Return the candidates to settle once `next` returns None; None if there are no more.

        The first batch is always settled, later ones only until a candidate is valid.
        """
        if not len(self._waiting) or (len(self._order) and self._seen_valid):
            return None
        return np.sort(self._waiting[: self.rests])

    def placed_at_rest(self, placement: Placement) -> None:
        """Store the placement in which the `waiting` candidates have settled."""
        self._placement, self._upper = placement, np.asarray(placement.bound)
        settled, self._waiting = np.split(self._waiting, [self.rests])
        self._first = len(self._order)
        settled = settled[np.argsort(-self._upper[settled], kind="stable")]
        self._order = np.concatenate([self._order, settled])

    def next(self) -> np.ndarray | slice | None:
        """Return the candidates to roll out next; None if no remaining one can become an elite.

        Without a batch size this is a slice of the whole population. The last batch is padded by
        repeating its candidates, so that all batches share one shape and one compilation.
        """
        if self._batch is None:
            return None if self._parts else slice(None)
        if self._first >= len(self._order):
            return None
        upper = self._upper[self._order[self._first]]
        if not np.isfinite(upper):
            return None
        if self._prunes and not self._until_valid and upper < self._best[0]:
            return None
        rows = self._order[self._first : self._first + self._batch]
        return np.resize(rows, min(self._batch, len(self._upper)))

    def add(self, scores: Scores) -> None:
        """Store the scores of the candidates that `next` returned last."""
        if self._batch is None:
            self._parts.append((np.arange(len(self._upper)), scores))
            self._seen_valid |= bool(np.any(scores.valid))
            return
        rows = self._order[self._first : self._first + self._batch]
        self._parts.append((rows, scores))
        self._seen_valid |= bool(np.any(scores.valid))
        self._until_valid &= not self._seen_valid
        # Repeated candidates that pad the batch must count once.
        reward = np.asarray(scores.reward)[: len(rows)]
        self._best = np.sort(np.concatenate([self._best, reward]))[-len(self._best) :]
        self._first += self._batch

    def scores(self) -> Scores:
        """Return the scores of all candidates.

        Candidates that were not rolled out have status PRUNED, reward -inf, and NaN for the terms
        that depend on physics.
        """
        if self._batch is None:
            return self._parts[0][1]
        pop, objects = self._placement.poses.scale.shape
        known = {name: np.array(value.value) for name, value in self._placement.values.items()}
        whole = {
            "valid": np.zeros(pop, bool),
            "status": np.full(pop, PRUNED, np.int32),
            "reward": np.full(pop, -np.inf, np.float32),
            "absolute": np.full(pop, -np.inf, np.float32),
            "fidelity": np.full(pop, -np.inf, np.float32),
            "drift": np.full((pop, objects), np.nan, np.float32),
            "depth": np.full((pop, objects), np.nan, np.float32),
        }
        credit = None
        for rows, part in self._parts:
            for name, values in part.terms.items():
                known.setdefault(name, np.full(pop, np.nan, np.float32))
                known[name][rows] = np.asarray(values)[: len(rows)]
            for name, array in whole.items():
                array[rows] = np.asarray(getattr(part, name))[: len(rows)]
            if part.credit is not None:
                credit = np.full((pop, objects), -np.inf, np.float32) if credit is None else credit
                credit[rows] = np.asarray(part.credit)[: len(rows)]
        return Scores(terms=known, credit=credit, **whole)

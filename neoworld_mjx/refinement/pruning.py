"""Exact pruning: candidates that cannot become elites are not rolled out.

Under `fixed` normalisation physics can only lower a reward whose terms all have a bound. Candidates
are rolled out in the order of their bounds, until the next bound is below the K-th best known
reward: no candidate after that can be among the K best.
"""

import numpy as np

from ..physics.engine import RolloutStatus
from .objective import Placement, Scores

PRUNED = len(RolloutStatus)
"""Status, in `Scores`, of a candidate that was not rolled out."""


class RolloutPlan:
    """Says which candidates of a population to roll out next, and puts their scores together.

    Args:
        placement: the candidates, with the upper bounds of their rewards.
        batch: candidates rolled out at once; None rolls all of them out at once and prunes nothing.
        elites: K.
        until_valid: prune nothing as long as no candidate is valid.
    """

    def __init__(
        self, placement: Placement, *, batch: int | None, elites: int, until_valid: bool = False
    ) -> None:
        self._placement = placement
        self._upper = np.asarray(placement.bound)
        self._order = np.argsort(-self._upper, kind="stable")
        self._batch, self._until_valid = batch, until_valid
        self._best = np.full(elites, -np.inf)
        self._first = 0
        self._parts: list[tuple[np.ndarray, Scores]] = []

    @property
    def rolled_out(self) -> int:
        """Candidates that were rolled out."""
        return sum(len(rows) for rows, _ in self._parts)

    def next(self) -> np.ndarray | slice | None:
        """Return the candidates to roll out now; None when the rest cannot become elites.

        Without a batch they are a slice of all.

        The last batch repeats some of its candidates, so that all batches share one shape and one
        compilation.
        """
        pop = len(self._upper)
        if self._batch is None:
            return None if self._parts else slice(None)
        if self._first >= pop or not np.isfinite(self._upper[self._order[self._first]]):
            return None
        if not self._until_valid and self._upper[self._order[self._first]] < self._best[0]:
            return None
        rows = self._order[self._first : self._first + self._batch]
        return np.resize(rows, min(self._batch, pop))

    def add(self, scores: Scores) -> None:
        """Take in the scores of the candidates that `next` returned last."""
        if self._batch is None:
            self._parts.append((np.arange(len(self._upper)), scores))
            return
        rows = self._order[self._first : self._first + self._batch]
        self._parts.append((rows, scores))
        self._until_valid &= not bool(np.any(scores.valid))
        # What filled the batch up comes a second time, and must count once.
        reward = np.asarray(scores.reward)[: len(rows)]
        self._best = np.sort(np.concatenate([self._best, reward]))[-len(self._best) :]
        self._first += self._batch

    def scores(self) -> Scores:
        """Return the scores of all candidates.

        Those that were not rolled out have status PRUNED, reward -inf, and NaN for the terms that
        depend on physics.
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

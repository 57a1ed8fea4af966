"""Ranking of candidates, and the winner: the best one whose final scene passes the final check."""

from typing import NamedTuple

import numpy as np

from ..config import RefineOptions
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..progress import update
from .evaluation import Round
from .finishing import Finished, finish


class Winner(NamedTuple):
    """Winner of a search, with its final scene and final check."""

    candidate: tuple[int, int]
    """(iteration, candidate). The initial layout is (0, 0) with settling, else (-1, -1)."""
    layout: Layout
    """Layout of the winner, with a population axis of length 1."""
    finished: Finished
    tried: int
    """Number of candidates whose final scene was checked."""


def rank_candidates(rounds: list[Round]) -> list[tuple[int, int]]:
    """Return (iteration, candidate) of the candidates with a finite reward, best first.

    Valid candidates come before all others; among them, and among the others, the reward decides.
    """
    ranked = [
        (not scores.valid[k], -float(scores.reward[k]), t, k)
        for t, (_, _, scores, _) in enumerate(rounds)
        for k in np.flatnonzero(np.isfinite(scores.reward)).tolist()
    ]
    return [(t, k) for _, _, t, k in sorted(ranked)]


def choose_winner(
    model: SceneModel,
    rounds: list[Round],
    o: RefineOptions,
    initial: Finished,
    start: Layout | None = None,
    searched: SceneModel | None = None,
    *,
    accept_initial: bool = True,
) -> Winner:
    """Choose the first candidate in the order of `rank_candidates` that passes the final check.

    By default, the final check uses a smaller time step than a rollout and simulates longer.

    - With settling, the initial layout wins if it passes, unless `accept_initial` is False.
    - Otherwise, the first `finalists` candidates are checked in order, until one passes.
    - If no candidate passes, the candidate that is closest to passing wins. With settling, the
      initial layout takes part in this comparison, so a search never makes a scene worse. Without
      settling, only the candidates are compared, as in Algorithm 1.

    Args:
        model: the compiled scene.
        rounds: all iterations.
        o: options of the check.
        initial: the final scene of the initial layout.
        start: initial layout, with a population axis of length 1. If None, it is the composed
            scene.
        searched: the scene that was searched, in which some objects may be fixed. If None, it is
            `model`.
        accept_initial: if False, the initial layout is ranked like any other candidate. Use this
            with user-defined terms.
    """
    first = 0 if o.settle.enabled else -1
    origin = Layout.zero(1, len(model.names)) if start is None else start
    unmoved = Winner((first, first), origin, initial, 0)
    if initial.passed and o.settle.enabled and accept_initial:
        return unmoved
    remaining = [at for at in rank_candidates(rounds) if at != unmoved.candidate or initial.passed]
    best = unmoved if o.settle.enabled or not remaining else None
    tries = min(o.finalists, len(remaining))
    for tried, (t, k) in enumerate(remaining[:tries], 1):
        update(done=tried, of=tries, unit="final check", rate=None, left_s=None)
        layouts, finished = rounds[t].layouts, initial
        if (t, k) != unmoved.candidate:
            finished = finish(model, layouts, k, o, rounds[t].poses, searched)
        winner = Winner((t, k), layouts[k : k + 1], finished, tried)
        if finished.passed:
            return winner
        if best is None or finished.excess_over_bounds(o) < best.finished.excess_over_bounds(o):
            best = winner
    assert best is not None
    return best._replace(tried=tries)

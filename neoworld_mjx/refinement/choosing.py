"""Ranking of candidates, and the winner: the best one whose final scene passes the final check."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..config import RefineOptions
from ..measure import SceneMeasure
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from ..progress import update
from ..spec import SceneSpec
from .finishing import Finished, finish
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


@dataclass(frozen=True)
class Winner:
    """Winner of a search, with its final scene and final check."""

    index: tuple[int, int]
    """(iteration, candidate). The initial layout is (0, 0) with settling, else (-1, -1)."""
    layout: Layout
    """Layout of the winner, with a population axis of length 1."""
    finished: Finished
    before: SceneMeasure
    """Measures of the initial layout's final check."""
    tried: int
    """Number of candidates whose final scene was checked."""

    @property
    def scene(self) -> SceneSpec:
        """The final scene of the winner."""
        return self.finished.scene

    @property
    def measure(self) -> SceneMeasure:
        """Measures of the winner's final check."""
        return self.finished.measure

    @property
    def passed(self) -> bool:
        """True if the winner passes the final check; see `Finished.passed`."""
        return self.finished.passed


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
    origin = Layout.zero(1, len(model.names)) if start is None else start
    first = 0 if o.settle.enabled else -1
    initial_winner = Winner((first, first), origin, initial, initial.measure, 0)
    if initial.passed and o.settle.enabled and accept_initial:
        return initial_winner
    remaining = [
        entry
        for entry, absolute in rank_candidates(rounds)
        if np.isfinite(absolute) and (entry != initial_winner.index or initial.passed)
    ]
    best: Winner | None = initial_winner if o.settle.enabled or not remaining else None
    tries = min(o.finalists, len(remaining))
    for tried, (t, k) in enumerate(remaining[:tries], 1):
        update(done=tried, of=tries, unit="final check", rate=None, left_s=None)
        if (t, k) == initial_winner.index:
            finished = initial
        else:
            finished = finish(model, rounds[t].layouts, k, o, rounds[t].poses, searched)
        winner = Winner((t, k), rounds[t].layouts[k : k + 1], finished, initial.measure, tried)
        if winner.passed:
            return winner
        if best is None or finished.excess_over_bounds(o) < best.finished.excess_over_bounds(o):
            best = winner
    assert best is not None
    return Winner(best.index, best.layout, best.finished, initial.measure, tries)

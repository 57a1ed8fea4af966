"""Choice of the winner: the best candidate whose final scene passes the check."""

from dataclasses import dataclass

import numpy as np

from ..config import RefineOptions
from ..measure import SceneMeasure
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..progress import update
from ..spec import SceneSpec
from .finishing import Finished, finish
from .rounds import Round, ranked


@dataclass(frozen=True)
class Winner:
    """The winner of a search, with its final check."""

    index: tuple[int, int]
    """(iteration, candidate); with settling, (0, 0) is the initial layout, else (-1, -1)."""
    layout: Layout
    """Pop axis of length 1."""
    finished: Finished
    before: SceneMeasure
    """Final check of the initial layout."""
    tried: int
    """Number of candidates whose final scene was checked."""

    @property
    def scene(self) -> SceneSpec:
        """The final scene."""
        return self.finished.scene

    @property
    def measure(self) -> SceneMeasure:
        """Its final check."""
        return self.finished.measure

    @property
    def passed(self) -> bool:
        """True if it passes."""
        return self.finished.passed


def choose(
    model: SceneModel,
    rounds: list[Round],
    o: RefineOptions,
    initial: Finished,
    start: Layout | None = None,
    searched: SceneModel | None = None,
    *,
    accept_initial: bool = True,
) -> Winner:
    """Choose the best valid candidate that also passes the final check.

    The check is finer and longer than a rollout. The initial layout wins if it passes, unless
    `accept_initial` is False, as for user-defined terms. If neither it nor one of the best
    `finalists` passes, the one closest to passing is returned, so that a search never makes a scene
    worse; without settling, the best candidates alone are compared, as in Algorithm 1.

    Args:
        model: the compiled scene.
        rounds: all iterations.
        o: options of the check.
        initial: the initial layout's final scene.
        start: initial layout, pop axis of length 1; None is the composed scene.
        searched: the scene of the candidates, in which objects may be held; None for `model`.
        accept_initial: False ranks the initial layout as the other candidates.
    """
    origin = Layout.zero(1, len(model.names)) if start is None else start
    first = 0 if o.settle.enabled else -1
    unmoved = Winner((first, first), origin, initial, initial.measure, 0)
    if initial.passed and o.settle.enabled and accept_initial:
        return unmoved
    remaining = [
        entry
        for entry, absolute in ranked(rounds)
        if np.isfinite(absolute) and (entry != unmoved.index or initial.passed)
    ]
    best: Winner | None = unmoved if o.settle.enabled or not remaining else None
    tries = min(o.finalists, len(remaining))
    for tried, (t, k) in enumerate(remaining[:tries], 1):
        update(done=tried, of=tries, unit="final check", rate=None, left_s=None)
        if (t, k) == unmoved.index:
            finished = initial
        else:
            finished = finish(model, rounds[t].layouts, k, o, rounds[t].poses, searched)
        winner = Winner((t, k), rounds[t].layouts[k : k + 1], finished, initial.measure, tried)
        if winner.passed:
            return winner
        if best is None or finished.badness(o) < best.finished.badness(o):
            best = winner
    assert best is not None
    return Winner(best.index, best.layout, best.finished, initial.measure, tries)

"""A scorer for tests of searches that a model scores."""

from typing import Any

import numpy as np

from neoworld_mjx.refinement.scorer import ScoreSource, SemanticScorer


class ConstantScorer(SemanticScorer):
    """Scores every candidate alike, without a model."""

    fallbacks: Any = ()

    def __init__(self, *_: Any, **__: Any) -> None:
        self.seen: list[Any] = []

    def best(self, reward: Any, top: Any = None) -> Any:
        return [0]

    def submit(self, iteration: Any, candidates: Any, layouts: Any, poses: Any) -> None:
        self.seen.append(layouts)

    def collect(self, iteration: Any) -> Any:
        return []

    def s_sem_of(self, iteration: Any, layouts: Any, geometric: Any) -> Any:
        np.testing.assert_array_equal(layouts.xy, self.seen[-1].xy)
        return np.full(len(geometric), 0.25), np.full(len(geometric), ScoreSource.SCORED, np.int8)

    def await_for(self, identities: Any) -> Any:
        return []

    def known(self, identity: Any) -> Any:
        return None

    def summary(self) -> dict[str, Any]:
        return {"calls": 0}

    def close(self) -> None:
        pass

"""A scorer for tests of searches that a model scores."""

from typing import Any

import numpy as np

from neoworld_mjx.refinement.scorer import ScoreSource, SemanticScorer


class ConstantScorer(SemanticScorer):
    """Scores every candidate alike, without a model."""

    fallbacks: Any = ()

    def __init__(self, *_: Any, **__: Any) -> None:
        self.seen: list[Any] = []

    def submit(self, iteration: Any, reward: Any, geometric: Any, layouts: Any, poses: Any) -> None:
        self.seen.append(layouts)

    def collect(self, iteration: Any) -> None:
        pass

    def s_sem_of(self, iteration: Any, geometric: Any) -> Any:
        return np.full(len(geometric), 0.25), np.full(len(geometric), ScoreSource.SCORED, np.int8)

    def known(self, identity: Any) -> Any:
        return None

    def summary(self) -> dict[str, Any]:
        return {"calls": 0}

    def close(self) -> None:
        pass

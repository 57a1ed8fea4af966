"""A scorer for tests of searches that a model scores."""

from typing import Any

import numpy as np

from neoworld_mjx.search.scorer import ScoreSource, SemanticScorer


class ConstantScorer(SemanticScorer):
    """Scores every candidate alike, without a model."""

    fallbacks: Any = ()

    def __init__(self, *_: Any, **__: Any) -> None:
        self.seen: list[Any] = []

    def submit(self, reward: Any, geometric: Any, layouts: Any, poses: Any) -> None:
        self.seen.append(layouts)

    def collect(self) -> Any:
        pop = len(self.seen[-1].yaw)
        return np.full(pop, 0.25), np.full(pop, ScoreSource.SCORED, np.int8)

    def summary(self) -> dict[str, Any]:
        return {"calls": 0}

    def close(self) -> None:
        pass

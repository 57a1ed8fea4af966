"""Scores of the scene that a search delivers: its winner at rest in C MuJoCo.

The final check settles the winning candidate once more, with a finer time step, so the delivered
scene is close to the candidate but not equal to it.
"""

import time

import numpy as np

from ..physics.engine import Engine
from ..physics.placed import poses_in_chunks
from ..physics.scene_arrays import pad_objects
from .choosing import Winner
from .evaluation import Evaluation
from .search_run import SearchResult


def delivered(
    result: SearchResult,
    winner: Winner,
    engine: Engine,
    s_sem: float | None = None,
) -> dict[str, float]:
    """Return `absolute`, `merit` and each reward term of the delivered scene, by name.

    Args:
        result: the search.
        winner: its winner.
        engine: the physics engine, which rolls the scene out once.
        s_sem: score of the winning candidate by a model; None computes the geometric one.
    """
    o = result.run.options
    if winner.index == (0, 0) and winner.passed and o.settle.enabled and s_sem is None:
        scores = result.rounds[0].scores  # The initial layout was scored at its resting pose.
    else:
        evaluation = Evaluation(
            result.scene, result.arrays, engine, o, 1, 1, {"score": 0.0}, time.perf_counter()
        )
        layout = pad_objects(winner.layout, result.arrays.count)
        start = poses_in_chunks(result.arrays, layout)
        rest = evaluation.resting(winner.scene, layout)
        by_model = None if s_sem is None else np.array([s_sem], np.float32)
        scores = evaluation.of_one(result, layout, start, rest, by_model)
    values = {"absolute": scores.absolute, "merit": scores.merit, **scores.terms}
    return {name: float(np.asarray(x)[0]) for name, x in values.items()}

"""Scores of the delivered scene: the final scene of the winner, settled in C MuJoCo.

The winning candidate is settled again for the final check, with a smaller time step than in the
search. The delivered scene is therefore close to the winning candidate, but not equal to it.
"""

import time
from collections.abc import Sequence

import numpy as np

from ..physics.engine import Engine
from ..physics.placed import place_in_chunks
from ..physics.scene_arrays import pad_objects
from .batching import concatenate_candidates, take, tile_size
from .choosing import Winner
from .evaluation import Evaluation
from .objective import Scores
from .search_run import SearchResult


def final_scene_scores(
    results: Sequence[SearchResult],
    winners: Sequence[Winner],
    engine: Engine,
    s_sem: float | None = None,
) -> list[dict[str, float]]:
    """Return the `absolute` and `merit` of every delivered scene, and the value of each term.

    Args:
        results: the searches of runs that were searched together.
        winners: the winner of each run.
        engine: the physics engine, which rolls out all scenes at once.
        s_sem: S_sem of the winning candidates by a model. If None, the geometric S_sem is
            computed.

    Returns:
        One dictionary per run, by name.
    """
    scores: list[Scores | None] = [
        # The search has already scored the initial layout at its settled poses.
        result.rounds[0].scores
        if winner.index == (0, 0)
        and winner.passed
        and result.run.options.settle.enabled
        and s_sem is None
        else None
        for result, winner in zip(results, winners, strict=True)
    ]
    missing = [k for k, known in enumerate(scores) if known is None]
    if missing:
        pairs = [(results[k], winners[k]) for k in missing]
        for k, of_run in zip(missing, _scores(pairs, engine, s_sem), strict=True):
            scores[k] = of_run
    rows = [{"absolute": s.absolute, "merit": s.merit, **s.terms} for s in scores if s is not None]
    return [{name: float(np.asarray(x)[0]) for name, x in row.items()} for row in rows]


def _scores(
    pairs: Sequence[tuple[SearchResult, Winner]], engine: Engine, s_sem: float | None
) -> list[Scores]:
    first = pairs[0][0]
    o, runs = first.run.options, len(pairs)
    tile = tile_size(runs, o.cem.population)
    scenes = first.scene, first.arrays, first.padded
    evaluation = Evaluation(*scenes, engine, o, runs, tile, {"score": 0.0}, time.perf_counter())
    layouts = [pad_objects(winner.layout, first.arrays.count) for _, winner in pairs]
    placed = place_in_chunks(first.arrays, concatenate_candidates(layouts))
    starts = [take(placed, slice(k, k + 1)) for k in range(runs)]
    rests = [
        evaluation.settled_poses(winner.scene, z)
        for (_, winner), z in zip(pairs, layouts, strict=True)
    ]
    by_model = None if s_sem is None else np.array([s_sem], np.float32)
    return evaluation.score_each([result for result, _ in pairs], layouts, starts, rests, by_model)

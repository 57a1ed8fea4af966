"""Exact pruning: what cannot become an elite is not rolled out.

Under `fixed` normalisation physics can only lower a reward, so D_pen, S_sem and the prior bound it
from above before anything moves. Candidates are rolled out in the order of their bounds, until the
next bound is below the K-th best reward known: no candidate after that can be among the K best.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..physics.engine import Rollout, RolloutStatus
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from .rewards import Placed, Scores, Weights, bound, score

PRUNED = len(RolloutStatus)
"""Status, in `Scores`, of a candidate that was not rolled out."""


def score_elites(
    scene: SceneModel,
    layouts: Layout,
    before: Placed,
    rollout: Callable[[Poses], Rollout],
    w: Weights,
    *,
    elites: int,
    batch: int,
    until_valid: bool = False,
    done: Callable[[Scores], None] | None = None,
) -> Scores:
    """Score the candidates that may be among the K best; the same K as if all had been rolled out.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        before: how they are judged before anything moves.
        rollout: rolls some placed candidates out.
        w: weights, with `fixed` normalisation.
        elites: K.
        batch: candidates rolled out at once.
        until_valid: prune nothing as long as no candidate is valid.
        done: called with the scores of each batch.

    Returns:
        Scores of all candidates, with status PRUNED, reward -inf and d_drift NaN where they were not
        rolled out.
    """
    upper = np.asarray(bound(before, w))
    order = np.argsort(-upper, kind="stable")
    pop = len(upper)
    best = np.full(elites, -np.inf)
    found: list[tuple[np.ndarray, Scores]] = []
    first = 0
    while first < pop and np.isfinite(upper[order[first]]):
        if not until_valid and upper[order[first]] < best[0]:
            break
        rows = order[first : first + batch]
        # The last batch is filled up, so that all have one shape and one compilation.
        index = jnp.asarray(np.resize(rows, min(batch, pop)))
        few, known = _take((layouts, before), index)
        scores = jax.block_until_ready(score(scene, few, rollout(known.start), w, before=known))
        found.append((rows, scores))
        if done is not None:
            done(scores)
        until_valid &= not bool(np.any(scores.valid))
        # What filled the batch up comes a second time, and must count once.
        reward = np.asarray(scores.reward)[: len(rows)]
        best = np.sort(np.concatenate([best, reward]))[-elites:]
        first += batch
    return _scattered(scene, before, found)


@eqx.filter_jit
def _take(tree: Any, index: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


def _scattered(scene: SceneModel, before: Placed, found: list[tuple[np.ndarray, Scores]]) -> Scores:
    pop = before.d_pen.shape[0]
    nothing = np.full(pop, -np.inf, np.float32)
    moved, reward, absolute = np.full(pop, np.nan, np.float32), nothing, nothing.copy()
    status, valid = np.full(pop, PRUNED, np.int32), np.zeros(pop, bool)
    credit = np.full((pop, len(scene.names)), -np.inf, np.float32)
    for rows, scores in found:
        for whole, part in (
            (moved, scores.d_drift),
            (reward, scores.reward),
            (absolute, scores.absolute),
            (status, scores.status),
            (valid, scores.valid),
            (credit, scores.credit),
        ):
            whole[rows] = np.asarray(part)[: len(rows)]
    return Scores(
        d_pen=before.d_pen,
        d_drift=jnp.asarray(moved),
        s_sem=before.s_sem,
        prior=before.prior,
        user=jnp.zeros((0, pop)),
        valid=jnp.asarray(valid),
        status=jnp.asarray(status),
        reward=jnp.asarray(reward),
        absolute=jnp.asarray(absolute),
        credit=jnp.asarray(credit),
    )

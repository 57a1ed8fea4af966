"""Algorithm 1 of the paper as pure functions: init, propose, evaluate, update, converged.

The functions can be jitted, and vmapped over problems and states that `stack` combines.
`loop.search` calls them. docs/architecture.md maps them to the lines of Algorithm 1.

    problem = open_problem(scene, RefineOptions())
    state = init(problem, seed=0)
    while not converged(problem, state):
        layouts = propose(problem, state, population)
        scores = evaluate(scene, problem, layouts, nw.rollout(scene, layouts))
        state = update(problem, state, layouts, scores)
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Integer, Key, UInt32

from ..physics.array_types import AnyArray
from ..physics.engine import Rollout, RolloutStatus
from ..physics.layout import Layout
from ..physics.placed import Placed, measure_settled
from ..physics.scene_arrays import SceneArrays, on_device
from .cem import elite_count, elite_rows
from .problem import Problem, open_problem, stack
from .rewards import drift_by_object, prior, symmetric_depth, total_depth
from .semantic import semantic_score

__all__ = [
    "Problem",
    "Scores",
    "SearchState",
    "converged",
    "evaluate",
    "init",
    "normalized_reward",
    "open_problem",
    "propose",
    "stack",
    "update",
]


class SearchState(eqx.Module):
    """State of a run between two iterations."""

    optimizer: Any
    """State of the optimizer."""
    seed: UInt32[Array, ""]
    """Seed of the run. Random keys are derived from the seed and the iteration number."""
    iteration: Int[Array, ""]
    progress: Float[Array, ""]
    """Largest reward of a valid candidate so far, or mean reward of the last elites; see
    `Problem.stop_by_best`. Initially -inf."""
    gain: Float[Array, ""]
    """Gain of `progress` in the last iteration; inf until it is finite."""


class Scores(eqx.Module):
    """Term values, reward and validity of an iteration's candidates."""

    terms: Mapping[str, Float[AnyArray, " pop"]]
    """Value of every term, by name."""
    reward: Float[AnyArray, " pop"]
    """R(z), the weighted sum of the saturated terms (`Term.saturated`), comparable between
    iterations; -inf for failed candidates."""
    rests: Bool[AnyArray, "pop object"]
    """True for objects that rest: penetration, drift and displacement by settling are below their
    bounds."""
    valid: Bool[AnyArray, " pop"]
    """True if all objects rest."""
    status: Int[AnyArray, " pop"]
    """RolloutStatus of each candidate. It is FAILED also if a term is not finite."""


def init(problem: Problem, seed: Integer[AnyArray, ""] | int = 0) -> SearchState:
    """Return the initial state of a run."""
    infinity = np.float32(np.inf)
    start = on_device((np.asarray(seed, np.uint32), np.int32(0), -infinity, infinity))
    return SearchState(problem.optimizer.init(problem.origin), *start)


@eqx.filter_jit
def propose(problem: Problem, state: SearchState, population: int) -> Layout:
    """Sample the population of an iteration: N candidates (Algorithm 1, line 3)."""
    return problem.optimizer.ask(_key(state), state.optimizer, population)


def _key(state: SearchState) -> Key[Array, ""]:
    """Return the random key of the current iteration."""
    return jax.random.fold_in(jax.random.key(state.seed), state.iteration)


def evaluate(
    scene: SceneArrays,
    problem: Problem,
    layouts: Layout,
    rollout: Rollout,
    placed: Placed | None = None,
    s_sem: Float[AnyArray, " pop"] | None = None,
) -> Scores:
    """Score an iteration's population (Algorithm 1, lines 5 to 10).

    Args:
        scene: the scene's arrays.
        problem: the run's problem.
        layouts: the candidates.
        rollout: rollout of the candidates.
        placed: poses of the candidates at the start of the rollout with their measures, from
            `measure_settled` if the candidates were settled. If None, the initial poses of the
            rollout are measured.
        s_sem: S_sem by a model, which replaces the geometric S_sem.
    """
    if placed is None:
        placed = measure_settled(scene, rollout.start, rollout.start)
    return _score(scene, problem, layouts, rollout, placed, s_sem)


@eqx.filter_jit
def _score(
    scene: SceneArrays,
    problem: Problem,
    layouts: Layout,
    rollout: Rollout,
    placed: Placed,
    s_sem: Float[AnyArray, " pop"] | None,
) -> Scores:
    drift = drift_by_object(scene, rollout, problem.distance, problem.angle)
    drift = jnp.maximum(drift, placed.settled)
    if s_sem is None:
        s_sem = lax.stop_gradient(semantic_score(scene, placed.depth, placed.visible))
    values = {
        "s_sem": jnp.asarray(s_sem, jnp.float32),
        "prior": prior(scene, layouts, problem.sigma, problem.origin),
        "d_pen": total_depth(placed.depth),
        "d_drift": jnp.sum(drift, axis=1),
    }
    for term in problem.terms:
        if term.fn is not None:
            values[term.name] = jnp.asarray(term.fn(scene, layouts, rollout), jnp.float32)
    finite = jnp.isfinite(sum(values.values()))
    lost = jnp.array([int(RolloutStatus.FAILED), int(RolloutStatus.TRUNCATED)])
    alive = ~jnp.isin(rollout.status, lost) & finite
    reward = sum(term.weight * term.saturated(values[term.name]) for term in problem.terms)
    deepest = jnp.max(symmetric_depth(placed.depth), axis=2)
    rests = (drift < 1.0) & (deepest < problem.max_depth) & alive[:, None]
    truncated = rollout.status == int(RolloutStatus.TRUNCATED)
    return Scores(
        terms=values,
        reward=jnp.where(alive, reward, -jnp.inf),
        rests=rests,
        valid=jnp.all(rests, axis=1),
        status=jnp.where(finite | truncated, rollout.status, int(RolloutStatus.FAILED)),
    )


def normalized_reward(problem: Problem, scores: Scores) -> Float[Array, " pop"]:
    """Return R(z) with terms "normalized across candidates within each CEM iteration" (the paper).

    The range of every term with a scale, over the candidates that did not fail, is mapped to
    [0, 1]. A term that has the same value for all candidates contributes zero.
    """
    alive = jnp.isfinite(scores.reward)
    reward = jnp.where(alive, 0.0, -jnp.inf)
    for term in problem.terms:
        value = jnp.where(alive, term.saturated(scores.terms[term.name]), 0.0)
        if term.scale is not None:
            low = jnp.min(jnp.where(alive, value, jnp.inf))
            spread = jnp.max(jnp.where(alive, value, -jnp.inf)) - low
            value = jnp.where(spread > 1e-12, (value - low) / jnp.maximum(spread, 1e-12), 0.0)
        reward += term.weight * value
    return reward


@eqx.filter_jit
def update(problem: Problem, state: SearchState, layouts: Layout, scores: Scores) -> SearchState:
    """Fit the optimizer to the elites of the population (Algorithm 1, lines 11 and 12)."""
    rank = normalized_reward(problem, scores) if problem.by_iteration else scores.reward
    rows, weight = elite_rows(rank, elite_count(problem.elite_ratio, len(rank)))
    total = jnp.sum(jnp.where(weight > 0, scores.reward[rows], 0.0))
    elite_mean = jnp.where(jnp.any(weight > 0), total / jnp.maximum(weight.sum(), 1.0), -jnp.inf)
    best = jnp.maximum(state.progress, jnp.max(jnp.where(scores.valid, scores.reward, -jnp.inf)))
    progress = jnp.where(problem.stop_by_best, best, elite_mean)
    known = jnp.isfinite(state.progress)
    optimizer = problem.optimizer.tell(
        state.optimizer, layouts, rank, key=_key(state), rests=scores.rests
    )
    return SearchState(
        optimizer=optimizer,
        seed=state.seed,
        iteration=state.iteration + 1,
        progress=progress,
        gain=jnp.where(known, progress - state.progress, jnp.inf),
    )


def converged(problem: Problem, state: SearchState) -> bool:
    """Return whether `SearchState.progress` gained less than `stop_gain` (Algorithm 1, line 13).

    The first gain is that over the first iteration, or the first valid candidate. With a
    `stop_gain` of 0, a run never converges.
    """
    return 0 < float(problem.stop_gain) > float(state.gain)

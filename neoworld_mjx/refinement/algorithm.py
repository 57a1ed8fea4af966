"""Algorithm 1 of the paper as data and pure functions: init, propose, evaluate, update, converged.

The functions can be jitted, sharded, and vmapped over problems and states that `stack` combines.
`loop.search` calls them. docs/architecture.md maps them to the lines of Algorithm 1.

    problem = open_problem(scene, RefineOptions())
    state = init(problem, seed=0)
    layouts = propose(scene, problem, state, population)
    scores = evaluate(scene, problem, layouts, nw.rollout(scene, layouts))
    state = update(scene, problem, state, layouts, scores)

One rule is not part of Algorithm 1. An object rests in a candidate if it meets the bounds of a
valid candidate (see `Scores.rested`). Each object has a factor that multiplies its standard
deviations:

- The factor is initially 0 for objects that rest in the initial layout, and 1 for all others.
- A factor that is not 0 doubles, up to a limit, in every iteration in which its object rests in no
  candidate.

Until a candidate is valid, the distribution of an object is fitted to the candidates in which this
object rests. `configs/paper.yaml` disables the rule.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Integer, Key, UInt32

from ..config import RefineOptions
from ..physics.array_types import AnyArray
from ..physics.engine import Rollout
from ..physics.layout import Layout
from ..physics.placed import Placed, measure_settled
from ..physics.scene_arrays import SceneArrays, on_device
from .cem import elite_count, elite_rows
from .objective import Objective, Scores, open_objective
from .objective import evaluate as score
from .optimizer import Optimizer, optimizer_factory
from .rewards import Term

__all__ = [
    "Problem",
    "SearchState",
    "converged",
    "evaluate",
    "init",
    "open_problem",
    "propose",
    "stack",
    "update",
]


class Problem(eqx.Module):
    """Constants of a run; its arrays are traced, so problems can be batched.

    The scene is not part of a problem, but a separate argument of each function. Many runs can
    therefore share the arrays of one scene.
    """

    objective: Objective
    optimizer: Optimizer
    origin: Layout
    """Initial layout, with a population axis of length 1."""
    max_factor: Float[Array, ""]
    """Upper limit of the factor that multiplies an object's standard deviations."""
    by_object: bool = eqx.field(static=True)
    """If True, each object is fitted to the candidates in which it rests, until one is valid."""
    stop_by_best: Bool[Array, ""]
    """Quantity that is tested for convergence: if True, the merit of the best valid candidate; if
    False, the mean absolute reward of the elites."""
    stop_gain: Float[Array, ""]
    """Gain of this quantity below which an iteration counts as stalled."""
    patience: Int[Array, ""]
    """Number of consecutive stalled iterations that end the run."""
    elite_ratio: float = eqx.field(static=True)
    """Fraction of the candidates that are elites."""


class SearchState(eqx.Module):
    """State of a run between two iterations."""

    optimizer: Any
    """State of the optimizer."""
    seed: UInt32[Array, ""]
    """Seed of the run. Random keys are derived from the seed and the iteration number."""
    sigma_factor: Float[Array, " object"]
    """Factor that multiplies the standard deviations of each object."""
    iteration: Int[Array, ""]
    elite_mean: Float[Array, ""]
    """Mean absolute reward of the elites of the last iteration; initially -inf."""
    best: Float[Array, ""]
    """Largest merit of a valid candidate so far; initially -inf."""
    any_valid: Bool[Array, ""]
    """True as soon as any candidate has been valid."""
    stalled: Int[Array, ""]
    """Number of consecutive iterations that gained less than `stop_gain`."""
    stuck: Bool[Array, " object"]
    """Mask of the objects that rested in no candidate although their factor was at its limit."""


def open_problem(
    scene: SceneArrays,
    options: RefineOptions,
    origin: Layout | None = None,
    *,
    terms: Sequence[Term] = (),
    optimizer: Optimizer | None = None,
) -> Problem:
    """Build the problem of a run from options.

    Args:
        scene: the scene's arrays.
        options: options of the search and the rewards.
        origin: initial layout, with a population axis of length 1. If None, the search starts at
            the composed scene.
        terms: reward terms in addition to those that the options name.
        optimizer: replaces the optimizer that the options name.

    Raises:
        ConfigError: two options contradict each other, or an option names something that does not
            exist.
    """
    o = options
    origin = Layout.zero(1, scene.count) if origin is None else origin
    return Problem(
        objective=open_objective(o, origin, terms),
        optimizer=optimizer or optimizer_factory(o.optimizer)(scene, o.cem),
        origin=origin,
        max_factor=on_device(o.cem.widest),
        by_object=o.cem.credit == "object",
        stop_by_best=on_device(np.bool_(o.cem.stop_by == "best")),
        stop_gain=on_device(o.cem.stop_gain),
        patience=on_device(o.cem.patience),
        elite_ratio=o.cem.elite_ratio,
    )


def init(
    problem: Problem,
    seed: Integer[AnyArray, ""] | int = 0,
    sigma_factor: Float[np.ndarray, " object"] | None = None,
) -> SearchState:
    """Return the initial state of a run.

    Args:
        problem: the run's problem.
        seed: the run's seed.
        sigma_factor: initial factors of the objects' standard deviations. If None, all factors are
            1.
    """
    if sigma_factor is None:
        sigma_factor = np.ones(problem.origin.yaw.shape[1])
    minus_infinity, zero = on_device((-np.inf, np.int32(0)))
    return SearchState(
        optimizer=problem.optimizer.init(problem.origin),
        seed=on_device(np.asarray(seed, np.uint32)),
        sigma_factor=on_device(np.asarray(sigma_factor, np.float32)),
        iteration=zero,
        elite_mean=minus_infinity,
        best=minus_infinity,
        any_valid=on_device(np.bool_(False)),
        stalled=zero,
        stuck=on_device(np.zeros(len(sigma_factor), bool)),
    )


@eqx.filter_jit
def propose(scene: SceneArrays, problem: Problem, state: SearchState, population: int) -> Layout:
    """Sample the population of an iteration (Algorithm 1, line 3).

    Args:
        scene: the scene's arrays.
        problem: the run's problem.
        state: the run's state.
        population: number of candidates, N.
    """
    del scene
    samples = problem.optimizer.ask(_key(state), state.optimizer, population)
    return jax.tree.map(
        lambda z, o, f: o + f * (z - o),
        samples,
        problem.origin,
        _layout_factors(state.sigma_factor),
    )


def _key(state: SearchState) -> Key[Array, ""]:
    """Return the random key of the current iteration."""
    return jax.random.fold_in(jax.random.key(state.seed), state.iteration)


def _layout_factors(factor: Float[Array, " object"]) -> Layout:
    """Return the factor of each layout variable. Factors above 1 apply to positions only."""
    least = jnp.minimum(factor, 1.0)[None]
    return Layout(jnp.tile(factor[None, :, None], 2), least, least)


def evaluate(
    scene: SceneArrays,
    problem: Problem,
    layouts: Layout,
    rollout: Rollout,
    candidates: Placed | None = None,
) -> Scores:
    """Score an iteration's population (Algorithm 1, lines 5 to 10).

    Args:
        scene: the scene's arrays.
        problem: the run's problem.
        layouts: the candidates.
        rollout: rollout of the candidates.
        candidates: poses of the candidates at the start of the rollout with their measures, from
            `measure_settled` if the candidates were settled. If None, the initial poses of the
            rollout are measured.
    """
    if candidates is None:
        candidates = measure_settled(scene, rollout.start, rollout.start)
    return score(scene, layouts, candidates, rollout, problem.objective)


@eqx.filter_jit
def update(
    scene: SceneArrays, problem: Problem, state: SearchState, layouts: Layout, scores: Scores
) -> SearchState:
    """Fit the optimizer to the elites of the population (Algorithm 1, lines 11 and 12)."""
    any_valid = state.any_valid | jnp.any(scores.valid)
    credit, never_rested = None, jnp.zeros_like(state.stuck)
    if problem.by_object:
        object_credit = scores.reward[:, None] if scores.credit is None else scores.credit
        by_object = jnp.where(scores.rested, object_credit, -jnp.inf)
        credit = jnp.where(any_valid, scores.reward[:, None], by_object)
        never_rested = scene.optimised & ~jnp.any(scores.rested, axis=0)
    samples = jax.tree.map(
        lambda z, o, f: o + jnp.where(f > 0, (z - o) / jnp.maximum(f, 1e-12), 0.0),
        layouts,
        problem.origin,
        _layout_factors(state.sigma_factor),
    )
    rows, weight = elite_rows(scores.reward, elite_count(problem.elite_ratio, len(scores.reward)))
    absolute = jnp.sum(jnp.where(weight > 0, scores.absolute[rows], 0.0))
    elite_mean = jnp.where(jnp.any(weight > 0), absolute / jnp.maximum(weight.sum(), 1.0), -jnp.inf)
    best = jnp.maximum(state.best, jnp.max(jnp.where(scores.valid, scores.merit, -jnp.inf)))
    current = jnp.where(problem.stop_by_best, best, elite_mean)
    previous = jnp.where(problem.stop_by_best, state.best, state.elite_mean)
    gain = jnp.where(jnp.isfinite(previous), current - previous, jnp.inf)
    updated = problem.optimizer.tell(
        state.optimizer,
        samples,
        scores.reward,
        key=_key(state),
        absolute=scores.absolute,
        credit=credit,
    )
    return SearchState(
        optimizer=updated,
        seed=state.seed,
        sigma_factor=jnp.where(
            never_rested,
            jnp.minimum(2 * state.sigma_factor, problem.max_factor),
            state.sigma_factor,
        ),
        iteration=state.iteration + 1,
        elite_mean=elite_mean,
        best=best,
        any_valid=any_valid,
        stalled=jnp.where(gain < problem.stop_gain, state.stalled + 1, 0),
        stuck=jnp.asarray(never_rested & (state.sigma_factor >= problem.max_factor)),
    )


def converged(problem: Problem, state: SearchState) -> bool:
    """Return whether a run has converged (Algorithm 1, line 13).

    A run has converged if a quantity gained less than `stop_gain` in each of the last `patience`
    iterations. By default this quantity is the merit of the best valid candidate, and a run
    converges only after a candidate has been valid. With `stop_by: elites` it is the mean absolute
    reward of the elites.
    """
    valid = not bool(problem.stop_by_best) or bool(state.any_valid)
    return valid and int(state.stalled) >= int(problem.patience)


def stack(rows: Sequence[Any]) -> Any:
    """Stack the arrays of pytrees, such as problems or states, on a new leading axis.

    Leaves that are not arrays, such as the functions of terms, are taken from the first tree.
    Arrays are stacked on the host, so each stacked array is transferred to the device once.

    Raises:
        ValueError: the trees differ in structure, for example because a static option differs.
    """
    structure = jax.tree.structure(rows[0])
    if any(jax.tree.structure(row) != structure for row in rows[1:]):
        raise ValueError("stack: the trees differ in structure, for example in a static option")
    arrays, rest = zip(*(eqx.partition(row, eqx.is_array) for row in rows), strict=True)
    return eqx.combine(jax.tree.map(lambda *x: np.stack(x), *arrays), rest[0])

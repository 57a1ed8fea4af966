"""Algorithm 1 of the paper as data and pure functions: propose, evaluate, update, converged.

`loop.search` calls them for one run or many; docs/architecture.md maps them to the
paper's lines. `evaluate` is in `objective`.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Integer

from ..config import RefineOptions
from ..errors import ConfigError
from ..physics.array_types import AnyArray
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays, on_device
from ..traces import stored_trace
from .cem import elite_count, elite_rows, initial_sigma
from .credit import assigned_credit, contact_components
from .gradient import refine_by_gradient
from .objective import Objective, Scores, open_objective
from .optimizer import Optimizer, open_optimizer, with_sigma
from .rewards import Term

by_gradient = stored_trace(refine_by_gradient, lambda scene, layouts, sigma: layouts)
"""`refine_by_gradient` with lowered programs stored on disk."""


class Problem(eqx.Module):
    """Constants of one run; arrays are traced, so runs can be mapped over."""

    objective: Objective
    optimizer: Optimizer
    sigma: Layout
    """Initial standard deviations, the unit of gradient steps; pop axis of length 1."""
    components: Float[Array, "object object"] | None
    """Contact components, if elites may be chosen per object; else None."""
    stop_by: str = eqx.field(static=True)
    """Quantity whose gain is tested for convergence: `best` or `elites`."""
    stop_gain: Float[Array, ""]
    patience: Int[Array, ""]
    elite_ratio: float = eqx.field(static=True)
    population: int = eqx.field(static=True)
    """N; iterations with fewer candidates do not update the optimizer."""
    until_valid: bool = eqx.field(static=True)
    """True if elites are chosen per object only until a candidate is valid."""


class SearchState(eqx.Module):
    """State of a run between two iterations."""

    optimizer: Any
    """The optimizer's state."""
    iteration: Int[Array, ""]
    elite_mean: Float[Array, ""]
    """Mean absolute reward of the last elites; initially -inf."""
    best: Float[Array, ""]
    """Fidelity of the best valid candidate so far; initially -inf."""
    gain: Float[Array, ""]
    """Increase of `best` or `elite_mean` in the last update; inf if the previous is infinite."""
    seen_valid: Bool[Array, ""]
    """True once any candidate was valid."""
    stalled: Int[Array, ""]
    """Number of consecutive iterations that gained less than `stop_gain`."""


def open_problem(
    scene: SceneArrays,
    options: RefineOptions,
    origin: Layout,
    *,
    moves: Bool[np.ndarray, " object"] | None = None,
    share: Float[np.ndarray, " object"] | None = None,
    terms: Sequence[Term] = (),
    optimizer: Optimizer | None = None,
) -> Problem:
    """Build a run's problem from options.

    Args:
        scene: the scene's arrays.
        options: options of the search and the rewards.
        origin: initial layout, pop axis of length 1.
        moves: objects that the search may move; default: all except environment supports.
        share: factor of the initial deviations of yaw and log scale, per object; default: 1.
        terms: reward terms in addition to those that the options name.
        optimizer: replaces the optimizer that the options name.

    Raises:
        ConfigError: options exclude each other, or name something that does not exist.
    """
    o = options
    check_credit(o, terms)
    if moves is not None:
        allowed = on_device(np.asarray(scene.optimised) & moves)
        scene = eqx.tree_at(lambda s: s.optimised, scene, allowed)
    has_user_terms = bool(o.reward.terms or terms)
    by_object = o.cem.credit != "scene" and not has_user_terms and o.semantic.scorer != "mllm"
    share = np.ones(scene.count, np.float32) if share is None else share
    sigma = initial_sigma(scene, o.cem, share=share)
    return Problem(
        objective=open_objective(o, origin, terms, on_device(share)),
        optimizer=optimizer or with_sigma(open_optimizer(o.optimizer, scene, o.cem), sigma),
        sigma=sigma,
        components=on_device(contact_components(scene, o.cem)) if by_object else None,
        stop_by=o.cem.stop_by,
        stop_gain=on_device(o.cem.stop_gain),
        patience=on_device(o.cem.patience),
        elite_ratio=o.cem.elite_ratio,
        population=o.cem.population,
        until_valid=o.cem.credit == "auto",
    )


def check_credit(options: RefineOptions, terms: Sequence[Term] = ()) -> None:
    """Check that per-object elites are possible if the options request them.

    Raises:
        ConfigError: a term or the scorer has no per-object values.
    """
    o = options
    if o.cem.credit in ("auto", "scene"):
        return
    if o.reward.terms or terms:
        raise ConfigError(
            "refine.cem.credit: user-defined terms have no per-object values; choose auto or scene"
        )
    if o.semantic.scorer == "mllm":
        raise ConfigError(
            "refine.cem.credit: a model scores whole scenes; choose auto or scene, or "
            "scorer geometric"
        )


def initial_state(problem: Problem, mean: Layout) -> SearchState:
    """Return the initial state of a run for a mean layout."""
    return SearchState(
        problem.optimizer.init(mean),
        *on_device((np.int32(0), -np.inf, -np.inf, np.inf, False, np.int32(0))),
    )


@eqx.filter_jit
def ask(
    scene: SceneArrays,
    problem: Problem,
    state: SearchState,
    seed: Integer[AnyArray, ""],
    population: int,
) -> Layout:
    """Draw the population of an iteration, from the run's seed and the iteration."""
    del scene
    key = jax.random.fold_in(jax.random.key(seed), state.iteration)
    return problem.optimizer.ask(key, state.optimizer, population)


def propose(
    scene: SceneArrays,
    problem: Problem,
    state: SearchState,
    seed: Integer[AnyArray, ""],
    population: int,
    projection: tuple[int, float, int] | None,
) -> Layout:
    """Draw a population, and optionally project it out of interpenetration (Algorithm 1, line 3).

    Args:
        scene: the scene's arrays.
        problem: the run's problem.
        state: the run's state.
        seed: the run's seed; the iteration is folded in.
        population: N.
        projection: steps, rate and samples of the gradient refinement; None returns the draws
            unchanged, as in the paper.
    """
    layouts = ask(scene, problem, state, seed, population)
    return layouts if projection is None else project(scene, problem, layouts, projection)


def project(
    scene: SceneArrays, problem: Problem, layouts: Layout, projection: tuple[int, float, int]
) -> Layout:
    """Project candidates out of interpenetration; `projection` as in `propose`."""
    steps, rate, samples = projection
    return by_gradient(
        scene, layouts, problem.sigma, steps=steps, rate=rate, samples=samples, photo=False
    )


def projects(option: str, t: int, state: SearchState) -> bool:
    """Return whether `descent.project` projects the candidates of iteration t."""
    needed = option == "needed" and t > 0 and not bool(state.seen_valid)
    return option == "always" or needed


@eqx.filter_jit
def update(
    scene: SceneArrays, problem: Problem, state: SearchState, layouts: Layout, scores: Scores
) -> SearchState:
    """Fit the optimizer to the population's elites (Algorithm 1, lines 11 and 12)."""
    del scene
    seen_valid = state.seen_valid | jnp.any(scores.valid)
    credit = None
    if problem.components is not None and scores.credit is not None:
        by_object = ~seen_valid if problem.until_valid else True
        credit = assigned_credit(scores.credit, scores.reward, problem.components, by_object)
    optimizer = state.optimizer
    if len(scores.reward) == problem.population:
        # A smaller population may have a single elite, which would collapse the deviations.
        optimizer = problem.optimizer.tell(
            optimizer, layouts, scores.reward, absolute=scores.absolute, credit=credit
        )
    elites = elite_count(problem.elite_ratio, len(scores.reward))
    rows, weight = elite_rows(scores.reward, elites)
    absolute = jnp.sum(jnp.where(weight > 0, scores.absolute[rows], 0.0))
    elite_mean = jnp.where(jnp.any(weight > 0), absolute / jnp.maximum(weight.sum(), 1.0), -jnp.inf)
    best = jnp.maximum(state.best, jnp.max(jnp.where(scores.valid, scores.fidelity, -jnp.inf)))
    current, previous = (
        (best, state.best) if problem.stop_by == "best" else (elite_mean, state.elite_mean)
    )
    gain = jnp.where(jnp.isfinite(previous), current - previous, jnp.inf)
    return SearchState(
        optimizer=optimizer,
        iteration=state.iteration + 1,
        elite_mean=elite_mean,
        best=best,
        gain=gain,
        seen_valid=seen_valid,
        stalled=jnp.where(gain < problem.stop_gain, state.stalled + 1, 0),
    )


def converged(problem: Problem, state: SearchState) -> bool:
    """Return whether a run has converged (Algorithm 1, line 13).

    It has if some candidate was valid, and the best valid candidate (or the elites, by `stop_by`)
    gained less than `stop_gain` for `patience` iterations.
    """
    return bool(state.seen_valid) and int(state.stalled) >= int(problem.patience)


def resumed(state: SearchState) -> SearchState:
    """Return the state with the convergence test reset, to continue a converged run."""
    renewed = on_device((np.float32(np.inf), np.int32(0)))
    return eqx.tree_at(lambda s: (s.gain, s.stalled), state, renewed)

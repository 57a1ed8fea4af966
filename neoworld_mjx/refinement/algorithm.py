"""Algorithm 1 of the paper as data and pure functions: propose, evaluate, update, converged.

`loop.search` calls them for one run or many; docs/architecture.md puts them beside the
paper's lines. `evaluate` stands in `objective`.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from ..config import RefineOptions
from ..errors import ConfigError
from ..physics.layout import Layout
from ..physics.model import SceneModel
from .cem import elite_count, elite_rows, initial_sigma
from .credit import assigned_credit, contact_components
from .gradient import refine_by_gradient
from .objective import Objective, Scores, open_objective
from .optimizer import Optimizer, open_optimizer
from .rewards import Term


class Problem(eqx.Module):
    """What stays the same during one run; arrays are traced, so runs can be mapped over."""

    objective: Objective
    optimizer: Optimizer
    sigma: Layout
    """Initial standard deviations, the unit of gradient steps; pop axis of length 1."""
    components: Float[Array, "object object"] | None
    """Contact components, where elites may be chosen by object; else None."""
    stop_gain: Float[Array, ""]
    patience: Int[Array, ""]
    elite_ratio: float = eqx.field(static=True)
    until_valid: bool = eqx.field(static=True)
    """Whether elites are chosen by object only until a candidate is valid."""


class SearchState(eqx.Module):
    """Where a run stands between two iterations."""

    optimizer: Any
    """The optimizer's state."""
    iteration: Int[Array, ""]
    elite_mean: Float[Array, ""]
    """Mean absolute reward of the last elites; -inf before the first."""
    gain: Float[Array, ""]
    """By how much `elite_mean` rose in the last update; inf before the second."""
    seen_valid: Bool[Array, ""]
    """Whether any candidate so far was valid."""
    stalled: Int[Array, ""]
    """Iterations in a row that gained less than `stop_gain`."""


def open_problem(
    scene: SceneModel,
    options: RefineOptions,
    origin: Layout,
    *,
    terms: Sequence[Term] = (),
    optimizer: Optimizer | None = None,
) -> Problem:
    """Build a run's problem from options.

    Args:
        scene: the compiled scene.
        options: of the search and the rewards.
        origin: initial layout, pop axis of length 1.
        terms: reward terms besides those that the options name.
        optimizer: in place of the one that the options name.

    Raises:
        ConfigError: options that exclude each other, or name what is not there.
    """
    o = options
    own = bool(o.reward.terms or terms)
    if o.cem.credit not in ("auto", "scene"):
        if own:
            raise ConfigError(
                "refine.cem.credit: a user's own terms are of the whole scene; choose auto or scene"
            )
        if o.semantic.scorer == "mllm":
            raise ConfigError(
                "refine.cem.credit: a model scores the whole scene; choose auto or scene, or "
                "scorer geometric"
            )
    by_object = o.cem.credit != "scene" and not own and o.semantic.scorer != "mllm"
    return Problem(
        objective=open_objective(o, origin, terms),
        optimizer=optimizer or open_optimizer(o.optimizer, scene, o.cem),
        sigma=initial_sigma(scene, o.cem),
        components=jnp.asarray(contact_components(scene, o.cem)) if by_object else None,
        stop_gain=jnp.asarray(o.cem.stop_gain, jnp.float32),
        patience=jnp.asarray(o.cem.patience),
        elite_ratio=o.cem.elite_ratio,
        until_valid=o.cem.credit == "auto",
    )


def initial_state(problem: Problem, mean: Layout) -> SearchState:
    """Return the state in which a run starts at a layout."""
    return SearchState(
        optimizer=problem.optimizer.init(mean),
        iteration=jnp.asarray(0),
        elite_mean=jnp.asarray(-jnp.inf),
        gain=jnp.asarray(jnp.inf),
        seen_valid=jnp.asarray(False),
        stalled=jnp.asarray(0),
    )


@eqx.filter_jit
def ask(
    scene: SceneModel, problem: Problem, state: SearchState, key: Key[Array, ""], population: int
) -> Layout:
    """Draw the population of an iteration; `key` is the run's."""
    del scene
    key = jax.random.fold_in(key, state.iteration)
    return problem.optimizer.ask(key, state.optimizer, population)


def propose(
    scene: SceneModel,
    problem: Problem,
    state: SearchState,
    key: Key[Array, ""],
    population: int,
    projection: tuple[int, float, int] | None,
) -> Layout:
    """Draw a population, and move it out of interpenetration (Algorithm 1, line 3).

    Args:
        scene: the compiled scene.
        problem: of the run.
        state: of the run.
        key: of the run; the iteration is folded in.
        population: N.
        projection: steps, rate and samples of the gradient refinement; None leaves the draws as
            they are, as the paper does.
    """
    layouts = ask(scene, problem, state, key, population)
    if projection is None:
        return layouts
    steps, rate, samples = projection
    return refine_by_gradient(
        scene, layouts, problem.sigma, steps=steps, rate=rate, samples=samples, photo=False
    )


@eqx.filter_jit
def update(
    scene: SceneModel, problem: Problem, state: SearchState, layouts: Layout, scores: Scores
) -> SearchState:
    """Fit the optimizer to the population's elites (Algorithm 1, lines 11 and 12)."""
    del scene
    seen_valid = state.seen_valid | jnp.any(scores.valid)
    credit = None
    if problem.components is not None and scores.credit is not None:
        by_object = ~seen_valid if problem.until_valid else True
        credit = assigned_credit(scores.credit, scores.reward, problem.components, by_object)
    optimizer = problem.optimizer.tell(
        state.optimizer, layouts, scores.reward, absolute=scores.absolute, credit=credit
    )
    elites = elite_count(problem.elite_ratio, len(scores.reward))
    best, weight = elite_rows(scores.reward, elites)
    absolute = jnp.sum(jnp.where(weight > 0, scores.absolute[best], 0.0))
    elite_mean = jnp.where(jnp.any(weight > 0), absolute / jnp.maximum(weight.sum(), 1.0), -jnp.inf)
    gain = jnp.where(state.iteration > 0, elite_mean - state.elite_mean, jnp.inf)
    return SearchState(
        optimizer=optimizer,
        iteration=state.iteration + 1,
        elite_mean=elite_mean,
        gain=gain,
        seen_valid=seen_valid,
        stalled=jnp.where(gain < problem.stop_gain, state.stalled + 1, 0),
    )


def converged(problem: Problem, state: SearchState) -> bool:
    """Tell whether a run may stop (Algorithm 1, line 13).

    It may when a valid candidate has been seen and the elites have gained less than `stop_gain` for
    `patience` iterations.
    """
    return bool(state.seen_valid) and int(state.stalled) >= int(problem.patience)

"""Algorithm 1 against a listing in NumPy, its elites, and its end."""

import jax
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.search.algorithm import (
    Scores,
    converged,
    init,
    normalized_reward,
    open_problem,
    propose,
    update,
)
from neoworld_mjx.search.rewards import Term
from tests.support import scenes
from tests.support.scenes import compile_scene

POP = 40
PAPER = {"hold_resting": False, "widest": 1.0, "stop_by": "elites"}
PAPER |= {"elite_ratio": 0.2, "population": POP}
LEAVES = ("xy", "yaw", "log_scale")


@pytest.fixture(scope="module")
def scene():
    return compile_scene(scenes.blocks(), samples=16)


def opened(scene, seed=0, terms=(), reward=None, **cem):
    o = RefineOptions.model_validate({"cem": cem, "reward": reward or {}})
    problem = open_problem(scene, o, terms=terms)
    return problem, init(problem, seed)


def scored(reward, valid=False, rests=True, terms=None):
    """Scores of a toy problem, in which only rewards, validity and rest matter."""
    pop = len(reward)
    rests = np.broadcast_to(np.asarray(rests, bool), (pop, 4))
    valid = np.broadcast_to(np.asarray(valid, bool), (pop,))
    reward = np.asarray(reward, np.float32)
    return Scores(terms or {}, reward, rests, valid, np.zeros(pop, np.int32))


def listing(draws, mean, std, elite_count):
    """Algorithm 1 of the paper, lines 3 to 12, with standard normal draws in place of line 3.

    Yields the candidates of every iteration, and the mean and deviations after it.
    """
    for noise in draws:
        candidates = [mean + std * row for row in noise]
        rewards = [toy_reward(z) for z in candidates]
        order = sorted(range(len(candidates)), key=lambda k: -rewards[k])
        elites = np.array([candidates[k] for k in order[:elite_count]])
        mean = elites.sum(axis=0) / elite_count
        std = np.sqrt(((elites - mean) ** 2).sum(axis=0) / elite_count)
        yield np.array(candidates), mean, std


def toy_reward(z):
    goal = 0.02 * np.cos(np.arange(z.size))
    return -np.sum(((z - goal) / 0.05) ** 2)


def flat(layout):
    """Numbers of every candidate of a layout, [pop, n]: xy, yaw and log scale of the objects."""
    parts = [np.asarray(getattr(layout, name), float) for name in LEAVES]
    return np.concatenate([x.reshape(len(x), -1) for x in parts], axis=1)


def standard_normal(scene, seed, iteration):
    """The draws of an iteration [pop, n]: one key for each object, four numbers each."""
    key = jax.random.fold_in(jax.random.key(seed), iteration)
    numbers = [
        np.asarray(jax.random.normal(jax.random.fold_in(key, k), (POP, 4)), float)
        for k in range(len(scene.names))
    ]
    by_object = np.stack(numbers, axis=1)
    xy, yaw, size = by_object[..., :2], by_object[..., 2], by_object[..., 3]
    return np.concatenate([xy.reshape(POP, -1), yaw, size], axis=1)


def test_with_the_papers_options_the_updates_are_those_of_algorithm_1(scene):
    iterations, seed = 5, 11
    problem, state = opened(scene, seed=seed, **PAPER)
    draws = [standard_normal(scene, seed, t) for t in range(iterations)]
    diagonal = np.asarray(scene.diagonal, float) * np.asarray(scene.optimised)
    free = np.asarray(scene.optimised, float)
    sigma = np.concatenate([np.repeat(0.05 * diagonal, 2), np.radians(15.0) * free, 0.1 * free])
    for candidates, mean, std in listing(draws, 0.0 * sigma, sigma, elite_count=8):
        layouts = propose(problem, state, POP)
        np.testing.assert_allclose(flat(layouts), candidates, atol=2e-6)
        rests = np.zeros((POP, 4), bool)  # which must not matter
        rewards = [toy_reward(z) for z in flat(layouts)]
        state = update(problem, state, layouts, scored(rewards, rests=rests))
        np.testing.assert_allclose(flat(state.optimizer.mean)[0], mean, atol=2e-6)
        np.testing.assert_allclose(flat(state.optimizer.std)[0], std, atol=2e-6)
    assert int(state.iteration) == iterations
    assert toy_reward(mean) > toy_reward(0.0 * mean) + 0.2


def test_elites_are_normalized_within_the_iteration_where_the_options_say_so(scene):
    """By iteration, a term of small values weighs as much as one of large values."""
    terms = [Term("small", None, 1.0, scale=1.0), Term("large", None, 0.9, scale=1.0)]
    small, large = np.zeros((2, POP), np.float32)
    small[3], large[5] = 1e-3, 9.0
    values = {"small": small, "large": large, **dict.fromkeys(("s_sem", "prior"), 0 * small)}
    values |= dict.fromkeys(("d_pen", "d_drift"), 0 * small)
    reward = small / (1 + small) + 0.9 * large / (1 + large)
    reward[7] = -np.inf
    first = {}
    for name in ("fixed", "iteration"):
        weights = {"normalisation": name}
        problem, state = opened(scene, terms=terms, reward=weights, elite_ratio=1 / POP, widest=1.0)
        layouts = propose(problem, state, POP)
        scores = scored(reward, terms=values)
        fitted = update(problem, state, layouts, scores).optimizer.mean
        first[name] = [k for k in range(POP) if np.allclose(fitted.yaw, layouts.yaw[k])]
    assert first == {"fixed": [5], "iteration": [3]}
    within = np.asarray(normalized_reward(problem, scored(reward, terms=values)))
    assert within[[3, 5, 0, 7]] == pytest.approx([1.0, 0.9, 0.0, -np.inf])


@pytest.mark.parametrize("stop_by", ["best", "elites"])
def test_a_search_converges_after_an_iteration_without_gain(scene, stop_by):
    problem, state = opened(scene, stop_by=stop_by, stop_gain=0.5)
    endless, _ = opened(scene, stop_by=stop_by, stop_gain=0.0)
    layouts = propose(problem, state, POP)
    stopped = []
    for level, valid in ((0.0, False), (1.0, False), (1.2, False), (1.4, True), (2.0, True)):
        state = update(problem, state, layouts, scored(np.full(POP, level), valid=valid))
        stopped.append(converged(problem, state))
        assert not converged(endless, state)
    state = update(problem, state, layouts, scored(np.full(POP, 2.1), valid=True))
    # The elites stall before any candidate is valid; the best valid candidate only after one is.
    assert stopped == [False, False, stop_by == "elites", stop_by == "elites", False]
    assert converged(problem, state)


def test_a_distribution_is_fitted_around_the_initial_layout(scene):
    high = scene.names.index("high")
    xy = np.zeros((1, 4, 2), np.float32)
    xy[0, high] = 0.03
    zero = np.zeros((1, 4), np.float32)
    o = RefineOptions.model_validate({"cem": {"elite_ratio": 0.1}})
    problem = open_problem(scene, o, Layout(xy, zero, zero))
    state = init(problem)
    np.testing.assert_array_equal(state.optimizer.mean.xy, xy)
    layouts = propose(problem, state, POP)
    reward = np.asarray(layouts.xy[:, high, 0])
    state = update(problem, state, layouts, scored(reward))
    elites = np.asarray(layouts.xy)[np.argsort(-reward)[:4], high].mean(axis=0)
    np.testing.assert_allclose(state.optimizer.mean.xy[0, high], elites, rtol=1e-5)

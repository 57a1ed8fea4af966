"""Algorithm 1 against a listing in NumPy, and the rule that says what moves."""

from pathlib import Path

import jax
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions, load_config
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.refinement.algorithm import (
    converged,
    init,
    open_problem,
    propose,
    update,
)
from neoworld_mjx.refinement.objective import Scores
from tests.support import scenes
from tests.support.scenes import compile_scene

POP = 40
PAPER = {"hold_resting": False, "widest": 1.0, "credit": "scene", "sigma_floor": 0.0}
PAPER |= {"zero_candidate": False, "stop_by": "elites", "elite_ratio": 0.2, "population": POP}
PAPER_FILE = Path(__file__).parents[2] / "configs" / "paper.yaml"
LEAVES = ("xy", "yaw", "log_scale")


@pytest.fixture(scope="module")
def scene():
    return compile_scene(scenes.blocks(), samples=16)


def opened(scene, factor=1.0, seed=0, **cem):
    o = RefineOptions.model_validate({"cem": cem, "settle": {"enabled": False}})
    count = len(scene.names)
    problem = open_problem(scene, o, Layout.zero(1, count))
    return problem, init(problem, seed, np.broadcast_to(np.float32(factor), count))


def scored(reward, valid=False, rested=True, credit=None):
    """Scores of a toy problem, in which only rewards, validity and rest matter."""
    pop = len(reward)
    reward = np.asarray(reward, np.float32)
    rested = np.broadcast_to(np.asarray(rested, bool), (pop, 4))
    zero = np.zeros((pop, 4), np.float32)
    valid = np.broadcast_to(np.asarray(valid, bool), (pop,))
    status = np.zeros(pop, np.int32)
    return Scores({}, valid, status, reward, reward, reward, zero, zero, rested, credit)


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
        layouts = propose(scene, problem, state, POP)
        np.testing.assert_allclose(flat(layouts), candidates, atol=2e-6)
        rested = np.zeros((POP, 4), bool)  # which must not matter
        rewards = [toy_reward(z) for z in flat(layouts)]
        state = update(scene, problem, state, layouts, scored(rewards, rested=rested))
        np.testing.assert_allclose(flat(state.optimizer.mean)[0], mean, atol=2e-6)
        np.testing.assert_allclose(flat(state.optimizer.std)[0], std, atol=2e-6)
    assert int(state.iteration) == iterations
    assert toy_reward(mean) > toy_reward(0.0 * mean) + 0.2
    np.testing.assert_array_equal(state.sigma_factor, 1.0)


def test_the_papers_configuration_has_these_options():
    """The options that the listing is compared with are those of `configs/paper.yaml`."""
    cem = load_config(PAPER_FILE).refine.cem
    for name in ("hold_resting", "widest", "credit", "sigma_floor", "zero_candidate", "stop_by"):
        assert getattr(cem, name) == PAPER[name], name
    assert not load_config(PAPER_FILE).refine.settle.enabled


def test_the_factor_doubles_while_an_object_rests_in_no_candidate(scene):
    problem, state = opened(scene, widest=12.0)
    low, high, ball = (scene.names.index(name) for name in ("low", "high", "ball"))
    rested = np.ones((POP, 4), bool)
    rested[:, high] = False
    rested[1:, ball] = False  # the ball rests in one candidate
    seen = []
    for _ in range(5):
        layouts = propose(scene, problem, state, POP)
        state = update(scene, problem, state, layouts, scored(np.arange(POP), rested=rested))
        seen.append((float(state.sigma_factor[high]), bool(state.stuck[high])))
    assert seen == [(2.0, False), (4.0, False), (8.0, False), (12.0, False), (12.0, True)]
    assert float(state.sigma_factor[low]) == float(state.sigma_factor[ball]) == 1.0
    assert not np.asarray(state.stuck)[[low, ball, scene.names.index("table")]].any()


def test_the_factor_widens_positions_but_never_yaw_or_scale(scene):
    problem, state = opened(scene, factor=(1.0, 1.0, 4.0, 0.25), zero_candidate=False)
    near, _ = opened(scene, zero_candidate=False)
    _, plain = opened(scene)
    one = propose(scene, near, plain, POP)
    many = propose(scene, problem, state, POP)
    for name, factors in (
        ("xy", (1, 1, 4, 0.25)),
        ("yaw", (1, 1, 1, 0.25)),
        ("log_scale", (1, 1, 1, 0.25)),
    ):
        a, b = (np.asarray(getattr(z, name)) for z in (one, many))
        for k, factor in enumerate(factors):
            np.testing.assert_allclose(b[:, k], factor * a[:, k], rtol=1e-5, atol=1e-7)


def test_until_a_candidate_is_valid_an_object_learns_where_it_rests(scene):
    low, high = (scene.names.index(name) for name in ("low", "high"))
    problem, state = opened(scene, sigma_floor=0.0, elite_ratio=0.1, stop_by="best")
    layouts = propose(scene, problem, state, POP)
    rested = np.ones((POP, 4), bool)
    rested[:, high] = np.arange(POP) >= 30
    credit = np.tile(np.arange(POP, dtype=np.float32)[::-1, None], (1, 4))
    fit = lambda scores: np.asarray(
        update(scene, problem, state, layouts, scores).optimizer.mean.yaw
    )
    mean = fit(scored(-np.arange(POP), rested=rested, credit=credit))
    yaw = np.asarray(layouts.yaw)
    assert mean[0, low] == pytest.approx(yaw[:4, low].mean(), rel=1e-5)
    assert mean[0, high] == pytest.approx(yaw[30:34, high].mean(), rel=1e-5)
    # Once a candidate is valid, the scene's reward selects the elites of all objects.
    valid = np.arange(POP) == 39
    mean = fit(scored(np.arange(POP), valid=valid, rested=rested, credit=credit))
    assert mean[0, low] == pytest.approx(yaw[36:, low].mean(), rel=1e-5)
    assert mean[0, high] == pytest.approx(yaw[36:, high].mean(), rel=1e-5)
    # By `credit: scene` it does so from the start.
    problem = open_problem(
        scene,
        RefineOptions.model_validate({"cem": {"credit": "scene", "elite_ratio": 0.1}}),
        Layout.zero(1, 4),
    )
    mean = fit(scored(np.arange(POP), rested=rested, credit=credit))
    assert mean[0, high] == pytest.approx(yaw[36:, high].mean(), rel=1e-5)


@pytest.mark.parametrize("stop_by", ["best", "elites"])
def test_a_search_converges_after_iterations_without_gain(scene, stop_by):
    problem, state = opened(scene, stop_by=stop_by, stop_gain=0.5, patience=2)
    layouts = propose(scene, problem, state, POP)
    stopped = []
    for level, valid in (
        (0.0, False),
        (0.1, False),
        (0.2, True),
        (1.0, True),
        (1.2, True),
        (1.3, True),
    ):
        scores = scored(np.full(POP, level), valid=valid)
        state = update(scene, problem, state, layouts, scores)
        stopped.append(converged(problem, state))
    # The elites stall before any candidate is valid; the best valid candidate only after one is.
    expected = [False, False, True, False, False, True]
    assert stopped == (expected if stop_by == "elites" else [False] * 5 + [True])


def test_a_distribution_is_fitted_around_the_initial_layout_and_what_is_held_keeps_its_own(scene):
    low, high = (scene.names.index(name) for name in ("low", "high"))
    xy = np.zeros((1, 4, 2), np.float32)
    xy[0, [low, high]] = 0.03, -0.02
    zero = np.zeros((1, 4), np.float32)
    cem = {"sigma_floor": 0.0, "elite_ratio": 0.1}
    o = RefineOptions.model_validate({"cem": cem, "settle": {"enabled": False}})
    problem = open_problem(scene, o, Layout(xy, zero, zero))
    factor = np.ones(4, np.float32)
    factor[low], factor[high] = 0.0, 4.0
    state = init(problem, 0, factor)
    layouts = propose(scene, problem, state, POP)
    reward = np.asarray(layouts.xy[:, high, 0])
    state = update(scene, problem, state, layouts, scored(reward))
    np.testing.assert_allclose(state.optimizer.mean.xy[0, low], xy[0, low], atol=1e-6)
    elites = np.asarray(layouts.xy)[np.argsort(-reward)[:4], high].mean(axis=0)
    again = propose(scene, problem, state, POP)
    np.testing.assert_allclose(np.asarray(again.xy)[0, high], elites, rtol=1e-5)

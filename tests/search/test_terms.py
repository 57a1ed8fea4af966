"""User-defined reward terms and optimizers, and drift of joints."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.config import CEMOptions, RefineOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.physics.engine import RolloutStatus
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.search import OPTIMIZERS, Term, algorithm, refine
from neoworld_mjx.search.algorithm import Scores
from neoworld_mjx.search.optimizer import from_evosax
from tests.support.scenes import compile_scene, stored_scene

SMALL = {
    "cem": {"population": 8, "iterations": 2, "elite_ratio": 0.25},
    "settle": {"enabled": False},
    "rollout": {"duration_s": 0.0},
    "check_duration_s": 0.05,
    "finalists": 1,
}


def options(**change):
    return RefineOptions.model_validate(SMALL | change)


@pytest.fixture(scope="module")
def scene():
    return compile_scene(stored_scene("crowded_2"), samples=32)


def right(scene, layouts, rollout):
    """Return the mean displacement to the right, in units of 10 cm."""
    return jnp.mean(layouts.xy[..., 0], axis=1) / 0.1


@pytest.mark.parametrize("name", [*OPTIMIZERS, "evosax:CMA_ES"])
def test_one_loop_runs_every_optimizer(scene, name):
    if name.startswith("evosax"):
        pytest.importorskip("evosax", reason="CMA-ES needs the extra baselines")
    term = Term("right", right, 200.0)
    refined = refine(scene, options(optimizer=name), seed=3, terms=[term])
    history = refined.history
    assert history["right"].shape == history["reward"].shape == (2, 8)
    assert list(history["term_names"]) == ["s_sem", "prior", "d_pen", "d_drift", "right"]
    assert history["term_weights"][-1] == 200.0
    static = ~np.asarray(scene.optimised)
    assert not history["xy"][:, :, static].any()
    gain = history["right"][1].mean() - history["right"][0].mean()
    assert gain > 0 or name == "random"
    assert repr(refined).count("\n") == 2


@pytest.mark.parametrize("name", ["evosax:SNES", "evosax:Open_ES", "evosax:CMA_ES"])
def test_a_strategy_draws_what_evosax_draws_by_itself(scene, name):
    """The same keys give the same populations as evosax's own loop on the same losses."""
    algorithms = pytest.importorskip("evosax.algorithms", reason="needs the extra baselines")
    problem = algorithm.open_problem(scene, options(optimizer=name))
    state = algorithm.init(problem, seed=5)
    free, sigma = np.asarray(problem.optimizer.free), flat(problem.optimizer.sigma)[0]
    es = algorithms.algorithms[name.partition(":")[2]](8, jnp.zeros(len(free)))
    params = es.default_params
    inner = es.init(jax.random.key(0), jnp.zeros(len(free)), params)
    for t in range(4):
        layouts = algorithm.propose(problem, state, 8)
        key = jax.random.fold_in(jax.random.key(np.uint32(5)), t)
        drawn, inner = es.ask(key, inner, params)
        found = flat(layouts)[:, free] / sigma[free]
        np.testing.assert_allclose(found, drawn, rtol=2e-4, atol=2e-4)
        loss = jnp.sum((drawn - 0.7) ** 2, axis=1)
        inner, _ = es.tell(jax.random.fold_in(key, 1), drawn, loss, inner, params)
        state = algorithm.update(problem, state, layouts, only_losses(scene, loss))


def flat(layouts):
    parts = [np.asarray(leaf) for leaf in (layouts.xy, layouts.yaw, layouts.log_scale)]
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)


def only_losses(scene, loss):
    """Return scores in which only the rewards matter."""
    reward = -np.asarray(loss)
    rests, no = np.ones((len(reward), len(scene.names)), bool), np.zeros(len(reward), bool)
    return Scores({}, reward, rests, no, np.zeros(len(reward), np.int32))


def test_a_strategy_has_parameters_and_errors_of_one_line(scene):
    pytest.importorskip("evosax", reason="needs the extra baselines")
    layouts = Layout.zero(1, len(scene.names))
    spread = []
    for size in (0.2, 1.0):
        snes = from_evosax("SNES", scene, options().cem, std_init=size)
        drawn = snes.ask(jax.random.key(0), snes.init(layouts), 8)
        spread.append(float(np.asarray(drawn.xy)[:, 1:].std()))
    assert spread[0] == pytest.approx(0.2 * spread[1], rel=1e-4)
    odd = CEMOptions(population=7)
    for name, cem, more, message in (
        ("SNESS", options().cem, {}, "evosax: .*did you mean 'SNES'"),
        ("SNES", options().cem, {"std_int": 1.0}, "std_int"),
        ("GuidedES", odd, {}, "population 7.*even"),
    ):
        with pytest.raises(ConfigError, match=message) as error:
            from_evosax(name, scene, cem, **more)
        assert "\n" not in str(error.value)


def scalar(scene, layouts, rollout):
    return jnp.mean(layouts.yaw)


def by_object(scene, layouts, rollout):
    return layouts.yaw


def raising(scene, layouts, rollout):
    raise KeyError("cup")


def two_arguments(scene, layouts):
    return layouts.yaw[:, 0]


def infinite(scene, layouts, rollout):
    return jnp.log(jnp.zeros(layouts.yaw.shape[0]))


@pytest.mark.parametrize(
    ("fn", "message"),
    [
        (scalar, r"got a scalar"),
        (by_object, r"must return shape \[pop\].*got \[8, 3\]"),
        (raising, "KeyError: 'cup'"),
        (two_arguments, "TypeError: too many positional arguments"),
        (infinite, "returned -inf for 8 of 8 candidates"),
        (lambda *_: None, "must return an array of shape .*got None"),
        (3.0, "is not a function of"),
    ],
)
def test_a_term_is_tried_before_the_search(scene, fn, message):
    with pytest.raises(ConfigError, match=message) as error:
        refine(scene, options(), terms=[Term("custom", fn, 1.0)])
    where = "no source file" if fn == 3.0 else r"test_terms\.py:\d+"
    assert error.match(rf"reward term custom \(.*{where}\)")


def sometimes(scene, layouts, rollout):
    """Return the shift to the right, and NaN for a shift to the left."""
    shift = jnp.sum(layouts.xy, axis=(1, 2))
    return jnp.where(shift < 0.0, jnp.nan, shift)


def test_a_term_that_is_nan_for_a_part_of_the_population_is_refused(scene):
    where = r"sometimes \(.*test_terms\.py:\d+\)"
    message = where + r" is nan for \d of 8 candidates in iteration 1(?!\.)"
    with pytest.raises(ConfigError, match=message):
        refine(scene, options(), terms=[Term("sometimes", sometimes, 1.0)])


class Losing(NativeEngine):
    """An engine that loses the first candidate of every population."""

    def rollout(self, *args, **more):
        rolled = super().rollout(*args, **more)
        pos, status = np.array(rolled.pos), np.array(rolled.status)
        pos[0], status[0] = np.nan, RolloutStatus.FAILED
        return eqx.tree_at(lambda r: (r.pos, r.status), rolled, (pos, status))


def test_a_term_may_be_nan_for_a_candidate_whose_rollout_has_failed(scene):
    def height(scene, layouts, rollout):
        return jnp.max(rollout.pos[:, -1, :, 2], axis=-1)

    o = options(rollout={"duration_s": 0.1})
    history = refine(scene, o, engine=Losing(), terms=[Term("height", height, 1.0)]).history
    bad = np.isnan(history["height"])
    assert bad[:, 0].all() and not bad[:, 1:].any()
    assert np.all(history["status"][bad] == RolloutStatus.FAILED)
    assert np.all(history["reward"][bad] == -np.inf)

"""The table of optimizers: which names open what, and what random search draws."""

from inspect import unwrap

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.config import CEMOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.refinement.cem import CEM, open_cem
from neoworld_mjx.refinement.optimizer import (
    OPTIMIZERS,
    Optimizer,
    open_optimizer,
    optimizer_factory,
)
from tests.support import scenes
from tests.support.scenes import compile_scene

OPTIONS = CEMOptions(zero_candidate=False)


@pytest.fixture(scope="module")
def scene():
    return compile_scene(scenes.blocks(), samples=16)


def test_random_search_always_draws_from_the_initial_gaussian(scene):
    search, cem = (open_optimizer(name, scene, OPTIONS) for name in ("random", "cem"))
    assert isinstance(search, Optimizer) and isinstance(cem, CEM)
    mean = Layout.zero(1, scene.count)
    key, state = jax.random.key(4), search.init(mean)
    layouts = search.ask(key, state, 6)
    first = cem.ask(key, cem.init(mean), 6)
    jax.tree.map(np.testing.assert_array_equal, layouts, first)
    after = search.tell(state, layouts, np.arange(6.0), absolute=None, credit=None)
    jax.tree.map(np.testing.assert_array_equal, search.ask(key, after, 6), layouts)
    learned = cem.tell(cem.init(mean), layouts, np.arange(6.0), absolute=None, credit=None)
    assert not np.array_equal(cem.ask(key, learned, 6).xy, layouts.xy)


def test_names_and_paths_open_an_optimizer(scene):
    assert optimizer_factory("cem") is open_cem is OPTIMIZERS["cem"]
    assert optimizer_factory("neoworld_mjx.refinement.cem:open_cem") is open_cem
    assert open_optimizer("cem", scene, OPTIONS, {}) is not None
    path = f"{__name__}:opened_with"
    assert unwrap(open_optimizer)(path, scene, OPTIONS) == (scene, OPTIONS)


def opened_with(scene, options):
    return scene, options


@pytest.mark.parametrize("name", ["cme", "no.module:function", "neoworld_mjx.refinement.cem:no"])
def test_an_unknown_optimizer_is_named(scene, name):
    with pytest.raises(ConfigError, match=f"refine.optimizer: .*{name.rpartition(':')[2]}"):
        open_optimizer(name, scene, OPTIONS)


@pytest.mark.parametrize("name", ["cem", "random", f"{__name__}:opened_with"])
def test_parameters_are_of_strategies_alone(scene, name):
    with pytest.raises(ConfigError, match=r"refine.strategy: a, b: .* not " + name):
        open_optimizer(name, scene, OPTIONS, {"a": 1.0, "b": 2.0})


def test_a_strategy_of_evosax_is_opened_by_its_name(scene):
    pytest.importorskip("evosax", reason="needs the extra baselines")
    for name, label in (("cma_es", "CMA_ES"), ("evosax:SNES", "SNES")):
        opened = open_optimizer(name, scene, OPTIONS, {"std_init": 0.3})
        by_factory = optimizer_factory(name)(scene, OPTIONS)
        assert opened.name == by_factory.name == label
    with pytest.raises(ConfigError, match="did you mean 'SNES'"):
        optimizer_factory("evosax:SNESS")
    with pytest.raises(ConfigError, match="std_int"):
        open_optimizer("evosax:SNES", scene, OPTIONS, {"std_int": 0.3})


def test_a_strategy_restarts_where_the_rewards_hardly_differ(scene):
    pytest.importorskip("evosax", reason="needs the extra baselines")
    options, key = OPTIONS.model_copy(update={"population": 8}), jax.random.key(1)
    es = open_optimizer("evosax:CMA_ES", scene, options, {"restart_spread": 0.1})
    state = es.init(Layout.zero(1, scene.count))
    layouts = es.ask(key, state, 8)
    apart = es.tell_with_key(key, state, layouts, jnp.linspace(0.0, 1.0, 8))
    alike = es.tell_with_key(key, state, layouts, jnp.linspace(0.0, 0.05, 8))
    assert float(abs(apart.inner.mean).max()) > 0
    assert float(abs(alike.inner.mean).max()) == 0 and float(alike.inner.std) == 1.0
    assert int(alike.inner.generation_counter) == 0 < int(apart.inner.generation_counter)
    with pytest.raises(ConfigError, match="PSO takes no restart_spread"):
        open_optimizer("evosax:PSO", scene, options, {"restart_spread": 0.1})

"""The table of optimizers: which names open what, and what random search draws."""

import jax
import numpy as np
import pytest

from neoworld_mjx.config import CEMOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.search.cem import CEM, open_cem
from neoworld_mjx.search.optimizer import OPTIMIZERS, Optimizer, optimizer_factory
from tests.support import scenes
from tests.support.scenes import compile_scene

OPTIONS = CEMOptions()


@pytest.fixture(scope="module")
def scene():
    return compile_scene(scenes.blocks(), samples=16)


def test_random_search_always_draws_from_the_initial_gaussian(scene):
    search, cem = (optimizer_factory(name)(scene, OPTIONS) for name in ("random", "cem"))
    assert isinstance(search, Optimizer) and isinstance(cem, CEM)
    mean = Layout.zero(1, scene.count)
    key, state = jax.random.key(4), search.init(mean)
    layouts = search.ask(key, state, 6)
    first = cem.ask(key, cem.init(mean), 6)
    jax.tree.map(np.testing.assert_array_equal, layouts, first)
    after = search.tell(state, layouts, np.arange(6.0), key=key, rests=None)
    jax.tree.map(np.testing.assert_array_equal, search.ask(key, after, 6), layouts)
    learned = cem.tell(cem.init(mean), layouts, np.arange(6.0), key=key, rests=None)
    assert not np.array_equal(cem.ask(key, learned, 6).xy, layouts.xy)


def test_names_and_paths_open_an_optimizer(scene):
    assert optimizer_factory("cem") is open_cem is OPTIMIZERS["cem"]
    assert optimizer_factory("neoworld_mjx.search.cem:open_cem") is open_cem
    assert optimizer_factory(f"{__name__}:opened_with")(scene, OPTIONS) == (scene, OPTIONS)


def opened_with(scene, options):
    return scene, options


@pytest.mark.parametrize("name", ["cme", "no.module:function", "neoworld_mjx.search.cem:no"])
def test_an_unknown_optimizer_is_named(scene, name):
    with pytest.raises(ConfigError, match=f"refine.optimizer: .*{name.rpartition(':')[2]}"):
        optimizer_factory(name)

"""User-defined reward terms and optimizers, and drift of joints."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.physics.engine import RolloutStatus
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.search import OPTIMIZERS, Term, refine
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


@pytest.mark.parametrize("name", [*OPTIMIZERS])
def test_one_loop_runs_every_optimizer(scene, name):
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


class Still(eqx.Module):
    """Optimizer that always proposes the initial layout."""

    def init(self, mean):
        return mean

    def ask(self, key, state, population):
        return jax.tree.map(lambda leaf: jnp.repeat(leaf, population, axis=0), state)

    def tell(self, state, layouts, reward, **_):
        return state


def test_a_user_defined_optimizer(scene):
    assert not refine(scene, options(), optimizer=Still()).history["xy"].any()
    with pytest.raises(ConfigError, match=r"refine\.optimizer: 'cems' is unknown.*cem"):
        refine(scene, options(optimizer="cems"))


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
        (by_object, r"shape \[pop\], here \[8\], got float32 \[8, 3\]"),
        (raising, "KeyError: 'cup'"),
        (two_arguments, "TypeError: too many positional arguments"),
        (infinite, "is -inf for 8 of 8 candidates in which no"),
        (lambda *_: None, r"must return one number per candidate.*\(None\)"),
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

"""Gradients of the reward terms at every object, still or moving, against finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.search import rewards
from tests.support import scenes
from tests.support.scenes import compile_scene


@pytest.fixture(scope="module")
def scene():
    """A table, an environment object, and two boxes of which one is 4 mm within the other."""
    a = scenes.block("a", (0.1, 0.1, 0.1))
    b = scenes.block("b", (0.08, 0.08, 0.08))
    return compile_scene(scenes.on_table((a, (0, 0), 0.0, {}), (b, (0.086, 0), 0.0, {})))


def by_differences(fn, layouts, step=2e-3):
    """Return the central differences of a function of layouts with one candidate."""
    slopes = []
    for name in ("xy", "yaw", "log_scale"):
        x = np.asarray(getattr(layouts, name))
        slope = np.zeros_like(x)
        for index in np.ndindex(x.shape):
            ends = []
            for sign in (1, -1):
                moved = x.copy()
                moved[index] += sign * step
                ends.append(float(fn(eqx.tree_at(lambda z, n=name: getattr(z, n), layouts, moved))))
            slope[index] = (ends[0] - ends[1]) / (2 * step)
        slopes.append(slope)
    return Layout(*slopes)


def away(scene):
    """A layout away from zero, in which the boxes overlap by a face."""
    zero = Layout.zero(1, 3)
    return eqx.tree_at(
        lambda z: (z.xy, z.log_scale),
        zero,
        (jnp.zeros((1, 3, 2)).at[0, 2].set(jnp.array([-0.004, 0.003])), zero.log_scale + 0.02),
    )


@pytest.mark.parametrize("where", ["zero", "away"])
def test_d_pen_has_the_gradient_of_finite_differences_in_every_number(scene, where):
    layouts = Layout.zero(1, 3) if where == "zero" else away(scene)
    d_pen = lambda z: rewards.d_pen(scene, z)[0]
    assert float(d_pen(layouts)) > 0.003
    slope, numeric = jax.grad(d_pen)(layouts), by_differences(d_pen, layouts)
    for name in ("xy", "log_scale"):
        found, expected = (np.asarray(getattr(x, name)) for x in (slope, numeric))
        np.testing.assert_allclose(found, expected, atol=5e-3, err_msg=name)
        assert np.abs(expected).max() > 0.02, name
    assert np.isfinite(np.asarray(slope.yaw)).all()


def test_s_sem_has_no_gradient(scene):
    slope = jax.grad(lambda z: rewards.s_sem(scene, z)[0])(away(scene))
    for leaf in jax.tree.leaves(slope):
        np.testing.assert_array_equal(np.asarray(leaf), 0.0)

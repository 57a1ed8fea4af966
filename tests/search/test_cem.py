"""CEM compared with a NumPy implementation on the same draws, and edge cases."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.config import CEMOptions
from neoworld_mjx.search import open_cem
from neoworld_mjx.search.cem import elite_rows
from neoworld_mjx.spec import Box
from neoworld_mjx.spec.scene import PoseUncertainty
from tests.support import scenes
from tests.support.scenes import compile_scene


@pytest.fixture(scope="module")
def scene():
    return compile_scene(scenes.blocks())


def test_initial_deviations_are_the_papers(scene):
    params = open_cem(scene, CEMOptions())
    low = scene.names.index("low")
    diagonal = np.hypot(0.1, 0.1)
    assert params.sigma.xy[0, low, 0] == pytest.approx(0.05 * diagonal, rel=1e-5)
    assert params.sigma.yaw[0, low] == pytest.approx(np.radians(15))
    assert params.sigma.log_scale[0, low] == pytest.approx(0.1)
    table = scene.names.index("table")
    assert not np.any(np.asarray(params.sigma.xy[0, table]))
    assert not np.any(np.asarray(params.sigma.log_scale[0, table]))


def test_deviations_of_an_aligned_object_are_those_of_the_estimate_and_at_most_the_papers():
    unknown = PoseUncertainty(along=0.5, across=0.001, yaw=0.02, log_scale=0.03)
    spec = scenes.blocks()
    objects = [
        item.model_copy(update={"uncertainty": unknown}) if item.name == "low" else item
        for item in spec.objects
    ]
    model = compile_scene(spec.model_copy(update={"objects": tuple(objects)}))
    low, ball = (model.names.index(name) for name in ("low", "ball"))
    sigma = open_cem(model, CEMOptions()).sigma
    # The camera looks along +x, and the table's frame is the world's.
    expected = [0.05 * np.hypot(0.1, 0.1), 0.001]
    np.testing.assert_allclose(sigma.xy[0, low], expected, rtol=1e-4)
    assert (sigma.yaw[0, low], sigma.log_scale[0, low]) == pytest.approx((0.02, 0.03))
    assert sigma.log_scale[0, ball] == pytest.approx(0.1)  # not aligned
    stated = open_cem(model, CEMOptions(sigma_log_scale=0.2, sigma_yaw_deg=3.0)).sigma
    assert (stated.yaw[0, low], stated.log_scale[0, low]) == pytest.approx((np.radians(3), 0.2))
    np.testing.assert_allclose(stated.xy, sigma.xy)


def test_an_object_on_a_wall_moves_along_it_and_does_not_rotate():
    wall = scenes.single("wall", (Box(size=(0.05, 2.0, 1.5)), (0, 0, 0.75)))
    picture = scenes.single("picture", (Box(size=(0.02, 0.4, 0.3)), (0, 0, 0.15)))
    hung = {"parent": "wall", "relation": "attached", "z": 0.8}
    scene = compile_scene(
        scenes.on_table((wall, (0, 0), 0.7, {}), (picture, (0.04, 0.2), 0.0, hung))
    )
    sigma = open_cem(scene, CEMOptions()).sigma
    wall, picture = (scene.names.index(name) for name in ("wall", "picture"))
    assert sigma.xy[0, picture, 0] == 0 and sigma.xy[0, picture, 1] > 0.01
    assert sigma.yaw[0, picture] == 0 and sigma.log_scale[0, picture] > 0
    assert (np.asarray(sigma.xy[0, wall]) > 0).all() and sigma.yaw[0, wall] > 0


def test_an_object_is_fitted_to_the_candidates_in_which_it_rests(scene):
    low, high = (scene.names.index(name) for name in ("low", "high"))
    cem = open_cem(scene, CEMOptions(elite_ratio=0.1, widest=3.0))
    state = cem.init()
    drawn = cem.ask(jax.random.key(2), state, 40)
    rests = np.ones((40, 4), bool)
    rests[:, high] = np.arange(40) >= 30
    reward, yaw = -np.arange(40, dtype=np.float32), np.asarray(drawn.yaw)
    fitted = cem.tell(state, drawn, reward, rests=rests)
    assert fitted.mean.yaw[0, low] == pytest.approx(yaw[:4, low].mean(), rel=1e-5)
    assert fitted.mean.yaw[0, high] == pytest.approx(yaw[30:34, high].mean(), rel=1e-5)
    # As in Algorithm 1, all objects are fitted to the same elites.
    plain = open_cem(scene, CEMOptions(elite_ratio=0.1, widest=1.0))
    fitted = plain.tell(state, drawn, reward, rests=rests)
    assert fitted.mean.yaw[0, high] == pytest.approx(yaw[:4, high].mean(), rel=1e-5)


def test_positions_of_an_object_that_rests_nowhere_widen_up_to_the_limit(scene):
    low, high = (scene.names.index(name) for name in ("low", "high"))
    cem = open_cem(scene, CEMOptions(widest=3.0))
    state, rests = cem.init(), np.ones((8, 4), bool)
    rests[:, high] = False
    ratios = []
    for t in range(3):
        drawn = cem.ask(jax.random.key(t), state, 8)
        state = cem.tell(state, drawn, jnp.arange(8.0), rests=rests)
        ratios.append(float(state.std.xy[0, high, 0] / cem.sigma.xy[0, high, 0]))
        assert state.std.xy[0, low, 0] < cem.sigma.xy[0, low, 0]
    assert ratios == pytest.approx([2.0, 3.0, 3.0])
    for name in ("yaw", "log_scale"):
        assert getattr(state.std, name)[0, high] == getattr(cem.sigma, name)[0, high]
    assert not np.asarray(state.mean.xy[0, high]).any()


def test_failed_candidates_never_become_elites(scene):
    cem = open_cem(scene, CEMOptions(elite_ratio=0.5))
    state = cem.init()
    drawn = cem.ask(jax.random.key(2), state, 8)
    reward = jnp.full(8, -jnp.inf).at[3].set(1.0).at[5].set(jnp.nan)
    assert np.allclose(cem.tell(state, drawn, reward).mean.yaw[0], drawn.yaw[3])
    plain = open_cem(scene, CEMOptions(widest=1.0))
    unchanged = plain.tell(state, drawn, jnp.full(8, -jnp.inf))
    jax.tree.map(np.testing.assert_array_equal, unchanged, state)


def test_rewards_that_are_not_finite_make_no_elites():
    best, weights = elite_rows(jnp.array([jnp.inf, 1.0, jnp.nan, 2.0]), 2)
    assert best.tolist() == [3, 1] and weights.tolist() == [1.0, 1.0]

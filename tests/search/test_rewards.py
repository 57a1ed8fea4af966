import functools
from inspect import unwrap

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions, RewardOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.physics.engine import zero_duration_rollout
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.placed import Placed
from neoworld_mjx.search import rewards
from neoworld_mjx.search.algorithm import evaluate, open_problem
from neoworld_mjx.search.problem import open_terms
from tests.support import scenes
from tests.support.scenes import compile_scene
from tests.support.visible import as_parsed


@functools.cache
def two_boxes(gap):
    """A scene that tests share, so that a program is compiled once for all of them."""
    a = scenes.block("a", (0.1, 0.1, 0.1))
    b = scenes.block("b", (0.1, 0.1, 0.1))
    return compile_scene(scenes.on_table((a, (0, 0), 0.0, {}), (b, (0.1 + gap, 0), 0.0, {})))


def shifted(scene, dx, pop=1):
    xy = np.zeros((pop, len(scene.names), 2), np.float32)
    xy[:, scene.names.index("b"), 0] = dx
    zero = Layout.zero(pop, len(scene.names))
    return Layout(jnp.asarray(xy), zero.yaw, zero.log_scale)


@pytest.mark.parametrize("depth", [0.0, 0.002, 0.01])
def test_d_pen_of_two_boxes_is_their_overlap(depth):
    scene = two_boxes(0.0)
    found = rewards.d_pen(scene, shifted(scene, -depth))
    assert float(found[0]) == pytest.approx(depth, abs=2e-6)


def test_drift_is_the_maximum_over_time_of_distance_and_angle():
    scene = compile_scene(scenes.blocks())
    rollout = NativeEngine().rollout(scene, scene.place(Layout.zero(2, 4)), duration=0.3)
    ball = scene.names.index("ball")
    pos = np.array(rollout.pos)
    pos[:] = pos[:, :1]
    pos[:] = np.asarray(rollout.start.pos)[:, None]
    pos[0, 1, ball, 0] += 0.03  # away and back again
    quat = np.broadcast_to(np.asarray(rollout.start.quat)[:, None], rollout.quat.shape).copy()
    half = np.radians(10.0) / 2
    quat[1, 0, ball] = [np.cos(half), np.sin(half), 0, 0]
    pos[1, 0, ball, 0] += 0.01  # less of its bound than the turn
    made = eqx.tree_at(lambda r: (r.pos, r.quat), rollout, (jnp.asarray(pos), jnp.asarray(quat)))
    far, turned = rewards.drifts(scene, made)
    assert float(far[0, ball]) == pytest.approx(0.03, abs=1e-6)
    assert float(turned[1, ball]) == pytest.approx(np.radians(10.0), abs=1e-4)
    found = rewards.d_drift(scene, Layout.zero(2, 4), made)
    assert found == pytest.approx(np.array([3.0, 2.0]), abs=1e-2)


@pytest.mark.parametrize(
    ("weight", "reward"),
    [
        ("w_sem", [0.25, 0.75]),
        ("w_prior", [0.0, -0.5]),
        ("w_pen", [0.0, -2 / 6]),
        ("w_drift", [0.0, -3 / 9]),
    ],
)
def test_each_term_has_its_sign_in_the_reward(weight, reward):
    """One weight is 1 and the others are 0: a better agreement raises the reward, costs lower it.

    The second candidate has S_sem 0.75, one of two objects turned by 2 sigma, an overlap of 2 mm
    (scale 4 mm), and a drift of 3 bounds (scale 6).
    """
    scene = two_boxes(0.0)
    b = scene.names.index("b")
    weights = dict.fromkeys(("w_sem", "w_prior", "w_pen", "w_drift"), 0.0) | {weight: 1.0}
    scales = {"d_pen_scale_m": 0.004, "d_drift_scale": 6.0}
    options = RefineOptions.model_validate(
        {"reward": {**weights, **scales}, "cem": {"sigma_yaw_deg": 10.0}}
    )
    yaw = np.zeros((2, 3), np.float32)
    yaw[1, b] = np.radians(20.0)
    layouts = Layout(jnp.zeros((2, 3, 2)), jnp.asarray(yaw), jnp.zeros((2, 3)))
    poses = scene.place(layouts)
    depth = np.zeros((2, 3, 3), np.float32)
    depth[1, 0, b] = 0.002
    placed = Placed(poses, depth, as_parsed(scene.photo, 2), np.zeros((2, 3), np.float32))
    pos = np.array(zero_duration_rollout(scene, poses).pos)
    pos[1, 0, b, 1] += 0.03
    rollout = eqx.tree_at(lambda r: r.pos, zero_duration_rollout(scene, poses), jnp.asarray(pos))
    agreement = np.array([0.25, 0.75], np.float32)
    problem = open_problem(scene, options)
    scores = evaluate(scene, problem, layouts, rollout, placed, agreement)
    assert scores.reward == pytest.approx(np.array(reward), abs=1e-5)
    assert scores.terms["d_drift"] == pytest.approx(np.array([0.0, 3.0]), abs=1e-4)
    assert scores.valid.tolist() == [True, False]


def test_the_prior_is_the_mean_square_of_all_numbers_over_their_deviations():
    scene = two_boxes(0.0)
    a, b = scene.names.index("a"), scene.names.index("b")
    diagonal = float(np.hypot(0.1, 0.1))
    sigma = (0.1, 0.2, 0.05)
    xy = np.zeros((1, 3, 2), np.float32)
    xy[0, b] = (0.3 * diagonal, 0.4 * diagonal)  # 3 and 4 sigma
    yaw, log_scale = np.zeros((2, 1, 3), np.float32)
    yaw[0, b], log_scale[0, a] = 0.2, -0.1  # 1 and -2 sigma
    yaw[0, scene.names.index("table")] = 1.0  # not optimised
    layouts = Layout(jnp.asarray(xy), jnp.asarray(yaw), jnp.asarray(log_scale))
    ones = np.ones((1, 3), np.float32)
    of_xy = np.full((1, 3, 2), sigma[0] * diagonal, np.float32)
    deviations = Layout(of_xy, sigma[1] * ones, sigma[2] * ones)
    of = lambda scene, origin: float(rewards.prior(scene, layouts, deviations, origin)[0])
    zero = Layout.zero(1, 3)
    assert of(scene, zero) == pytest.approx((4 / 4 + (9 + 16 + 1) / 4) / 2)
    alone = eqx.tree_at(lambda s: s.optimised, scene, jnp.arange(3) == b)
    assert of(alone, zero) == pytest.approx(6.5)
    assert of(scene, layouts) == 0.0


def test_drift_of_joints_is_their_peak_over_the_bound_of_their_kind():
    """Of three records the second is the peak: 2 cm of a slide (bound 1 cm), 15 of 5 degrees."""
    cabinet = (scenes.cabinet(), (0, 0), 0.0, {"fixed_base": True})
    scene = compile_scene(scenes.on_table(cabinet), samples=16)
    still = zero_duration_rollout(scene, scene.place(Layout.zero(2, 2)))
    slides = np.asarray(scene.joint_slides)
    shift = np.zeros((2, 3, len(slides)), np.float32)
    shift[0, 1, np.flatnonzero(slides)[0]] = 0.02
    shift[1, 1, np.flatnonzero(~slides)[0]] = np.radians(15.0)
    rollout = eqx.tree_at(lambda r: r.joint_shift, still, jnp.asarray(shift))
    found = rewards.drift_by_object(scene, rollout, 0.01, np.radians(5.0))
    k = scene.names.index("cabinet")
    assert found[:, k] == pytest.approx(np.array([2.0, 3.0]), rel=1e-5)
    assert found[:, scene.names.index("table")].tolist() == [0.0, 0.0]
    drift = rewards.d_drift(scene, Layout.zero(2, 2), rollout)
    assert drift == pytest.approx(np.array([2.0, 3.0]), rel=1e-5)


@pytest.mark.parametrize(
    "path", ["nowhere.module:term", "math:no_such", "math", "math:pi", "d_pen"]
)
def test_an_unknown_term_is_named(path):
    with pytest.raises(ConfigError, match=r"refine\.reward\.terms.*" + path):
        open_terms(RefineOptions(reward=RewardOptions(terms={path: 1.0})))


@functools.cache
def gaps_of_two_boxes():
    """The scene, its gaps, and the gradient of the gap of its two boxes."""
    scene = two_boxes(0.0)
    a, b = scene.names.index("a"), scene.names.index("b")
    between = lambda layouts, start=None: rewards.gaps(scene, layouts, start)
    return scene, jax.jit(between), jax.jit(jax.grad(lambda z: between(z)[0, a, b]))


@pytest.mark.parametrize("gap", [0.03, 0.002, -0.004])
def test_the_gap_of_two_boxes_is_signed(gap):
    scene, between, slope_of = gaps_of_two_boxes()
    here, moved = shifted(scene, gap), shifted(scene, gap + 0.01)
    found = np.asarray(between(here))[0]
    a, b, table = (scene.names.index(name) for name in ("a", "b", "table"))
    assert found[a, b] == found[b, a] == pytest.approx(gap, abs=2e-6)
    assert found[a, table] == pytest.approx(0.0, abs=1e-5)
    assert np.isinf(found.diagonal()).all()
    assert float(between(moved)[0, a, b]) == pytest.approx(gap + 0.01, abs=2e-6)
    start = zero_duration_rollout(scene, scene.place(moved))
    assert between(here, start)[0, a, b] == pytest.approx(gap + 0.01, abs=2e-6)
    slope = slope_of(here)
    assert float(slope.xy[0, b, 0]) == pytest.approx(1.0, abs=1e-3)
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(slope))


def test_speeds_are_those_of_free_fall():
    scene = two_boxes(0.05)
    start = scene.place(Layout.zero(1, 3))
    high = eqx.tree_at(
        lambda p: p.pos, start, start.pos + 0.5 * np.eye(3)[2] * scene.movable[:, None]
    )
    rollout = NativeEngine().rollout(scene, high, duration=0.2, record_every=0.05)
    speed, turn = rewards.speeds(rollout)
    b = scene.names.index("b")
    time = np.asarray(rollout.time)
    # The mean over an interval, and half a time step of the integrator.
    expected = 9.81 * (time - time[0] / 2 + 0.002)
    np.testing.assert_allclose(speed[0, :, b], expected, rtol=0.01)
    assert (
        float(jnp.max(turn)) < 1e-3 and float(jnp.max(speed[:, :, scene.names.index("table")])) == 0
    )


class TestCompiled:
    """Rewards called from Python are compiled, and compose with transformations of JAX."""

    def test_a_wrong_type_is_an_error_that_names_the_expected_type(self):
        scene = two_boxes(0.0)
        zero = Layout.zero(1, 3)
        # Unwrapped, since the suite checks annotations before the functions themselves do.
        d_pen, d_drift, s_sem = map(unwrap, (rewards.d_pen, rewards.d_drift, rewards.s_sem))
        for call, match in (
            (lambda: d_pen("run/scene.json", zero), "SceneModel"),
            (lambda: s_sem(scene.spec, zero), "SceneModel"),
            (lambda: d_pen(scene, np.zeros(3)), "Layout"),
            (lambda: d_drift(scene, zero, None), "Rollout"),
        ):
            with pytest.raises(TypeError, match=match):
                call()

    def test_axes_that_do_not_fit_are_an_error_that_names_the_shape(self):
        scene = two_boxes(0.0)
        d_pen, d_drift = map(unwrap, (rewards.d_pen, rewards.d_drift))
        zero = Layout.zero(2, 3)
        still = zero_duration_rollout(scene, scene.place(zero))
        more = Layout.zero(2, 3)
        object.__setattr__(more, "log_scale", np.zeros(2))  # Checks of annotations are for tests.
        for call, match in (
            (lambda: d_pen(scene, Layout.zero(2, 4)), r"layouts.xy has shape \[2, 4, 2\], for 2"),
            (lambda: d_pen(scene, more), r"layouts.log_scale has shape \[2\].*\[2, 3\]"),
            (lambda: d_drift(scene, Layout.zero(5, 3), still), r"rollout.pos has .*for 5 candid"),
        ):
            with pytest.raises(ValueError, match=match):
                call()

    def test_they_jit_and_vmap(self):
        """For gradients by layouts, see test_gradients."""
        scene = two_boxes(0.0)
        layouts = shifted(scene, -0.008, pop=2)
        many = jax.tree.map(lambda x: jnp.stack([x, 2 * x, 0 * x]), layouts)
        for term in (rewards.d_pen, rewards.s_sem):
            plain = term(scene, layouts)
            mapped = jax.jit(jax.vmap(lambda z, t=term: t(scene, z)))(many)
            assert np.allclose(mapped[0], plain, atol=1e-6)

    def test_drift_is_differentiable_in_the_motion(self):
        scene = two_boxes(0.0)
        still = zero_duration_rollout(scene, scene.place(Layout.zero(1, 3)))
        drift = lambda dx: rewards.d_drift(
            scene, Layout.zero(1, 3), eqx.tree_at(lambda r: r.pos, still, still.pos + dx)
        )[0]
        assert float(jax.grad(drift)(0.001)) == pytest.approx(2 * np.sqrt(3) / 0.01, rel=1e-3)

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions, RewardOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.physics.engine import RolloutStatus
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement import rewards
from neoworld_mjx.spec import Box
from tests.support import scenes
from tests.support.scenes import random_layout


def two_boxes(gap):
    a = scenes.single("a", (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0)))
    b = scenes.single("b", (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0)))
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


def test_d_pen_has_the_right_gradient():
    scene = two_boxes(-0.01)
    loss = lambda dx: rewards.d_pen(scene, shifted_by(scene, dx))[0]
    shifted_by = lambda s, dx: Layout(
        jnp.zeros((1, 3, 2)).at[0, 2, 0].set(dx), jnp.zeros((1, 3)), jnp.zeros((1, 3))
    )
    slope = jax.grad(loss)(0.0)
    step = 1e-3
    numeric = (loss(step) - loss(-step)) / (2 * step)
    assert float(slope) == pytest.approx(-1.0, abs=1e-3)
    assert float(slope) == pytest.approx(float(numeric), abs=1e-2)


def test_drift_takes_the_worst_moment_and_the_worse_of_distance_and_angle():
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
    made = rollout.__class__(
        rollout.time,
        jnp.asarray(pos),
        jnp.asarray(quat),
        rollout.status,
        rollout.start,
        rollout.steps,
    )
    far, turned = rewards.drifts(scene, made)
    assert float(far[0, ball]) == pytest.approx(0.03, abs=1e-6)
    assert float(turned[1, ball]) == pytest.approx(np.radians(10.0), abs=1e-4)
    found = rewards.d_drift(scene, Layout.zero(2, 4), made)
    assert found == pytest.approx(np.array([3.0, 2.0]), abs=1e-2)


def weights(**change):
    return rewards.weights(RefineOptions(reward=RewardOptions(**change)))


def test_iteration_normalisation_spans_zero_to_one_over_the_living():
    pen = jnp.array([0.0, 0.001, 0.002, jnp.nan])
    moved = jnp.array([1.0, 1.0, 1.0, 1.0])
    alive = jnp.array([True, True, True, False])
    found = rewards.compose(pen, moved, jnp.zeros(4), alive, weights(normalisation="iteration"))
    assert found[:3] == pytest.approx(np.array([0.0, -0.5, -1.0]))
    assert float(found[3]) == -np.inf


def test_fixed_normalisation_clips_at_the_cap():
    pen = jnp.array([0.0, 0.01, 5.0])
    w = weights(normalisation="fixed", d_pen_cap_m=0.02)
    found = rewards.compose(pen, jnp.zeros(3), jnp.zeros(3), jnp.ones(3, bool), w)
    assert found == pytest.approx(np.array([0.0, -0.5, -1.0]))


def test_failed_candidates_score_minus_infinity_and_are_never_valid():
    scene = compile_scene(scenes.blocks())
    layouts = random_layout(scene, 4, spread=0.1)
    rollout = NativeEngine().rollout(scene, scene.place(layouts), duration=0.1)
    status = rollout.status.at[1].set(int(RolloutStatus.FAILED))
    broken = rollout.__class__(
        rollout.time, rollout.pos, rollout.quat, status, rollout.start, rollout.steps
    )
    found = rewards.score(scene, layouts, broken, weights())
    assert float(found.reward[1]) == -np.inf
    assert float(found.absolute[1]) == -np.inf
    assert not bool(found.valid[1])
    assert np.all(np.isfinite(np.asarray(found.reward)[[0, 2, 3]]))


def test_s_sem_prefers_what_the_photo_shows():
    scene = compile_scene(scenes.blocks())
    count = len(scene.names)
    low, ball = scene.names.index("low"), scene.names.index("ball")
    xy = np.zeros((4, count, 2), np.float32)
    xy[1, ball, 1] = -0.35  # to the other side
    size = np.zeros((4, count), np.float32)
    size[2, low] = -0.3  # relatively smaller
    xy[3, ball, 1] = -0.1  # into the block
    found = rewards.s_sem(scene, Layout(jnp.asarray(xy), jnp.zeros((4, count)), jnp.asarray(size)))
    assert float(found[0]) == pytest.approx(1.0)
    assert np.all(np.asarray(found[1:]) < 0.95)
    assert np.all((np.asarray(found) >= 0) & (np.asarray(found) <= 1))


def higher_is_better(scene, layouts, rollout):
    """A user's own term: the height of the highest object at the end."""
    return jnp.max(rollout.pos[:, -1, :, 2], axis=-1)


def test_a_users_own_term_counts():
    scene = compile_scene(scenes.blocks())
    layouts = random_layout(scene, 4, spread=0.1)
    rollout = NativeEngine().rollout(scene, scene.place(layouts), duration=0.1)
    path = f"{__name__}:higher_is_better"
    import sys

    sys.modules.setdefault(__name__, sys.modules[higher_is_better.__module__])
    options = RefineOptions(reward=RewardOptions(terms={path: 2.0}))
    terms = rewards.user_terms(options.reward)
    with_term = rewards.score(scene, layouts, rollout, rewards.weights(options), terms)
    without = rewards.score(scene, layouts, rollout, rewards.weights(RefineOptions()))
    gained = np.asarray(with_term.absolute - without.absolute)
    expected = 2.0 * np.asarray(higher_is_better(scene, layouts, rollout))
    assert gained == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("path", ["nowhere.module:term", "math:no_such", "math", "math:pi"])
def test_a_term_that_cannot_be_imported_is_named(path):
    with pytest.raises(ConfigError, match="terms"):
        rewards.user_terms(RewardOptions(terms={path: 1.0}))

"""Validity and status of candidates, each with one measure at or beside its bound."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.engine import RolloutStatus, zero_duration_rollout
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.placed import Placed
from neoworld_mjx.search.algorithm import evaluate, open_problem
from tests.support import scenes
from tests.support.scenes import compile_scene
from tests.support.visible import as_parsed

OPTIONS = RefineOptions()
DEPTH, DRIFT = np.float32(OPTIONS.max_depth_m), OPTIONS.max_drift_m
TILT = np.radians(OPTIONS.max_tilt_deg)
STATES = (
    *("still", "deep at the bound", "deep below it", "settled at the bound", "settled below it"),
    *("moved beyond", "moved below", "turned beyond", "truncated", "failed"),
)
VALID = {"still", "deep below it", "settled below it", "moved below"}


@pytest.fixture(scope="module")
def judged():
    """Scores of one candidate for each of STATES, and the indices of a and b."""
    box = scenes.block("a", (0.1, 0.1, 0.1))
    other = box.model_copy(update={"name": "b"})
    scene = compile_scene(
        scenes.on_table((box, (0, 0), 0.0, {}), (other, (0.3, 0), 0.0, {})), samples=16
    )
    a, b = (scene.names.index(name) for name in "ab")
    pop, at = len(STATES), STATES.index
    layouts = Layout.zero(pop, 3)
    poses = scene.place(layouts)
    depth, settled = np.zeros((pop, 3, 3), np.float32), np.zeros((pop, 3), np.float32)
    # One direction alone, whichever.
    depth[at("deep at the bound"), a, b] = DEPTH
    depth[at("deep below it"), b, a] = 0.99 * DEPTH
    settled[at("settled at the bound"), b] = 1.0
    settled[at("settled below it"), b] = 0.5
    still = zero_duration_rollout(scene, poses)
    pos, quat = np.array(still.pos), np.array(still.quat)
    pos[at("moved beyond"), 0, a, 0] += 1.01 * DRIFT
    pos[at("moved below"), 0, a, 2] -= 0.98 * DRIFT
    half = 1.01 * TILT / 2
    quat[at("turned beyond"), 0, b] = [np.cos(half), 0.0, np.sin(half), 0.0]
    status = np.array(still.status)
    status[at("truncated")] = RolloutStatus.TRUNCATED
    status[at("failed")] = RolloutStatus.FAILED
    rollout = eqx.tree_at(
        lambda r: (r.pos, r.quat, r.status), still, tuple(map(jnp.asarray, (pos, quat, status)))
    )
    candidates = Placed(poses, depth, as_parsed(scene.photo, pop), settled)
    problem = open_problem(scene, OPTIONS)
    return evaluate(scene, problem, layouts, rollout, candidates), a, b


@pytest.mark.parametrize("state", STATES)
def test_a_candidate_is_valid_if_every_object_is_within_every_bound(judged, state):
    scores, _, _ = judged
    assert bool(scores.valid[STATES.index(state)]) == (state in VALID)


def test_the_object_beyond_a_bound_is_the_one_that_does_not_rest(judged):
    scores, a, b = judged
    for state, restless in {
        "deep at the bound": {a, b},
        "settled at the bound": {b},
        "moved beyond": {a},
        "turned beyond": {b},
    }.items():
        rests = np.asarray(scores.rests)[STATES.index(state)]
        assert set(np.flatnonzero(~rests)) == restless, state
    assert not np.asarray(scores.rests)[[STATES.index("failed"), STATES.index("truncated")]].any()


def test_candidates_that_were_not_simulated_keep_their_status_and_have_no_reward(judged):
    scores, _, _ = judged
    status, reward = np.asarray(scores.status), np.asarray(scores.reward)
    for state in ("truncated", "failed"):
        assert reward[STATES.index(state)] == -np.inf
    assert status[STATES.index("truncated")] == RolloutStatus.TRUNCATED
    assert status[STATES.index("failed")] == RolloutStatus.FAILED
    assert not status[:-2].any() and np.isfinite(reward[:-2]).all()
    assert np.all(reward[1:-2] < reward[0])


def test_displacement_by_settling_costs_as_much_as_drift(judged):
    scores, _, _ = judged
    drift = np.asarray(scores.terms["d_drift"])
    assert drift[STATES.index("settled below it")] == pytest.approx(0.5)
    assert drift[STATES.index("settled at the bound")] == pytest.approx(1.0)

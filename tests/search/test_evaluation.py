"""Placement, settling, rollout and scores of populations, on padded arrays."""

import jax
import numpy as np
import pytest
from neoworld_bench.engines.table_scenes import Noise, noisy_layouts

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.engine import zero_duration_rollout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.placed import measure_settled
from neoworld_mjx.physics.scene_arrays import pad_objects
from neoworld_mjx.search.algorithm import evaluate
from neoworld_mjx.search.evaluation import early_stop_rule, open_evaluation
from neoworld_mjx.search.searched_scene import compile_for_search
from tests.support.scenes import stored_scene

POP = 8


class Noted(NativeEngine):
    """Notes the arguments of each rollout."""

    def __init__(self):
        super().__init__(threads=1)
        self.calls = []

    def rollout(self, scene, poses, **given):
        self.calls.append(given)
        return super().rollout(scene, poses, **given)


def options(*, settled=True, **rollout):
    rollout = {"engine": "native", "duration_s": 0.2, "samples_per_object": 32, **rollout}
    return RefineOptions.model_validate(
        {
            "cem": {"population": POP, "iterations": 1, "hold_resting": False},
            "settle": {"enabled": settled, "duration_s": 0.4},
            "rollout": rollout,
            "check_duration_s": 0.1,
        }
    )


@pytest.fixture(scope="module")
def model():
    return compile_for_search(stored_scene("crowded_2"), options())


def opened(model, o):
    return open_evaluation(model, o, Noted())


@pytest.fixture(scope="module")
def evaluation(model):
    return opened(model, options())


@pytest.fixture(scope="module")
def layouts(model, evaluation):
    return pad_objects(
        noisy_layouts(model, POP, seed=1, noise=Noise(xy=0.02)), evaluation.arrays.count
    )


def assert_near(a, b):
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-5), a, b)


def test_populations_are_measured_where_they_settled(evaluation, layouts, model):
    placed = evaluation.place(layouts)
    assert evaluation.clock["settle"] > 0 and evaluation.clock["score"] > 0
    start = jax.device_get(evaluation.arrays.place(layouts))
    shift = np.abs(np.asarray(placed.poses.pos) - start.pos).max(axis=2)
    assert (shift[:, : model.count].max(axis=1) > 1e-5).all()
    assert not shift[:, model.count :].any(), "padding does not move"
    assert_near(placed, measure_settled(evaluation.arrays, start, placed.poses))
    unsettled = opened(model, options(settled=False)).place(layouts)
    assert_near(unsettled.poses, evaluation.arrays.place(layouts))
    assert np.asarray(placed.settled).any() and not np.asarray(unsettled.settled).any()


def test_scores_of_a_model_replace_the_geometric_ones(evaluation, layouts):
    placed = evaluation.place(layouts)
    rollout = evaluation.roll_out(placed.poses)
    given = np.linspace(0, 1, POP, dtype=np.float32)
    geometric = evaluation.score(layouts, placed, rollout)
    by_model = evaluation.score(layouts, placed, rollout, given)
    np.testing.assert_array_equal(by_model.terms["s_sem"], given)
    change = evaluation.options.reward.w_sem * (given - np.asarray(geometric.terms["s_sem"]))
    np.testing.assert_allclose(by_model.reward - geometric.reward, change, atol=1e-5)
    before = evaluation.score_before_physics(layouts, placed)
    still = zero_duration_rollout(evaluation.arrays, placed.poses)
    assert_near(before, evaluate(evaluation.arrays, evaluation.problem, layouts, still, placed))


def test_rollouts_have_the_options_and_stop_at_the_scale_of_drift(model, layouts):
    o = options(early_stop=False, record_every_s=0.05)
    evaluation = opened(model, o)
    poses = evaluation.arrays.place(layouts)
    rollout = evaluation.roll_out(poses)
    assert evaluation.engine.calls == [{"duration": 0.2, "record_every": 0.05, "early_stop": None}]
    assert rollout.pos.shape == (POP, 4, model.count, 3)
    still = opened(model, options(duration_s=0.0))
    np.testing.assert_array_equal(still.roll_out(poses).pos[:, 0], poses.pos[:, : model.count])
    assert not still.engine.calls
    bounds = {"max_drift_m": 0.02, "max_tilt_deg": 9.0, "reward": {"d_drift_scale": 4.0}}
    rule = early_stop_rule(RefineOptions.model_validate(bounds))
    assert (rule.distance, rule.drift) == pytest.approx((0.02, 0.08))
    assert (rule.angle, rule.tilt) == pytest.approx((np.radians(9.0), np.radians(36.0)))

"""Numbers of an iteration and of a whole refinement, as reports and histories state them."""

from dataclasses import replace

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement.choosing import Winner
from neoworld_mjx.refinement.finishing import compile_for_search
from neoworld_mjx.refinement.loop import search
from neoworld_mjx.refinement.scene_refinement import outcome
from tests.support import scenes

OPTIONS = RefineOptions.model_validate(
    {
        "cem": {"population": 8, "iterations": 1, "hold_resting": False},
        "settle": {"enabled": False},
        "rollout": {"duration_s": 0.0, "samples_per_object": 32},
        "check_duration_s": 0.05,
    }
)


@pytest.fixture(scope="module")
def searched():
    model = compile_for_search(scenes.blocks(), OPTIONS)
    result = search(model, OPTIONS, NativeEngine(threads=1))
    return model, result


def refined(searched, *, passed=True, layout=None, result=None, **given):
    model, known = searched
    initial = known.initial
    measure = initial.measure
    if not passed:
        measure = measure.model_copy(update={"displacement": {"low": 0.5, "ball": 1.5}})
    finished = initial._replace(passed=passed, measure=measure)
    layout = Layout.zero(1, len(model.names) + 3) if layout is None else layout
    winner = Winner((0, 2), layout, finished, initial.measure, 3)
    call = {"engine": "native", "clock": {"search": 2.0}, "delivered": {"absolute": 1.0}}
    result = known if result is None else result
    return outcome(model, result, result.rounds, winner, **call | given)


def test_means_are_of_the_objects_that_may_move(searched):
    model, _ = searched
    wide = len(model.names) + 3  # padded
    xy, yaw, log_scale = np.zeros((1, wide, 2)), np.zeros((1, wide)), np.zeros((1, wide))
    xy[0, 1:4] = [[0.03, 0.04], [0.0, 0.0], [0.0, -0.1]]
    yaw[0, 1:4] = np.radians([30.0, -60.0, 0.0])
    log_scale[0, 1:4] = [0.3, -0.3, 0.3]
    xy[0, 4:], yaw[0, 4:], log_scale[0, 4:] = 9.0, 9.0, 9.0
    xy[0, 0], yaw[0, 0], log_scale[0, 0] = 9.0, 9.0, 9.0
    assert list(np.asarray(model.optimised)) == [False, True, True, True]
    result = refined(searched, layout=Layout(*map(np.float32, (xy, yaw, log_scale))))
    assert result.mean_shift_m == pytest.approx(0.15 / 3)
    assert result.mean_turn_deg == pytest.approx(30.0)
    assert result.mean_log_scale == pytest.approx(0.1)
    assert result.layout.xy.shape == (1, 4, 2)
    far = Layout(*map(np.float32, (400 * xy, yaw, log_scale)))
    text = repr(refined(searched, layout=far))
    assert "mean shift 20000.0 mm, turn 30.0 deg, log scale +0.100" in text


def test_the_history_has_all_candidates_and_terms(searched):
    model, result = searched
    history = refined(searched).history
    assert history["reward"].shape == history["d_pen"].shape == (1, 8)
    assert history["xy"].shape == (1, 8, 4, 2)
    np.testing.assert_array_equal(history["merit"][0], result.rounds[0].scores.merit)
    np.testing.assert_array_equal(history["valid"][0], result.rounds[0].scores.valid)
    weights = dict(zip(history["term_names"], history["term_weights"], strict=True))
    reward = OPTIONS.reward
    assert weights == {
        "s_sem": reward.w_sem, "prior": pytest.approx(-reward.w_prior),
        "d_pen": pytest.approx(-reward.w_pen), "d_drift": pytest.approx(-reward.w_drift),
    }  # fmt: skip
    assert history["object_names"].tolist() == list(model.names)
    assert "s_sem_from" not in history


def test_failures_are_listed(searched):
    _, known = searched
    stuck = replace(known, stuck=("low", "ball"))
    result = refined(searched, passed=False, result=stuck)
    ended, failed = result.fallbacks
    assert "did not pass the check" in repr(result)
    assert ended == (
        "the search ended after 1 iterations: in no candidate did low, ball rest where the "
        "photograph shows it"
    )
    assert failed.startswith("no candidate passed the final check in 3 tries; the closest one is")
    assert failed.endswith(
        "ball: settled away from its place by 150 % of the limit, at most 100 % of the limit"
    )

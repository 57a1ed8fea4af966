"""The order in which final scenes are checked, and that a search never makes a scene worse."""

import jax
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions, SettleOptions
from neoworld_mjx.physics.layout import Layout, Poses
from neoworld_mjx.search import choosing
from neoworld_mjx.search.algorithm import Scores
from neoworld_mjx.search.choosing import choose_winner, rank_candidates
from neoworld_mjx.search.evaluation import Round
from neoworld_mjx.search.finishing import finish
from neoworld_mjx.spec import Box
from tests.support import scenes
from tests.support.scenes import compile_scene

OPTIONS = RefineOptions(finalists=3, check_duration_s=0.5)
UNSETTLED = OPTIONS.model_copy(update={"settle": SettleOptions(enabled=False)})
FALLS, STANDS = 0.06, 0.03
"""Offsets of the plate's center from that of its support [m], whose edge is at 0.05."""
NEAR = [FALLS + 1e-4 * k for k in range(6)]


@pytest.fixture(scope="module")
def models():
    """A plate on a block, composed where it falls and where it stands."""
    low = scenes.single("low", (Box(size=(0.1, 0.1, 0.06)), (0, 0, 0)))
    plate = scenes.single("plate", (Box(size=(0.1, 0.06, 0.02)), (0, 0, 0)))
    on_low = {"parent": "low", "z": 0.06}
    return {
        x: compile_scene(
            scenes.on_table((low, (0, 0), 0.0, {}), (plate, (x, 0.0), 0.0, on_low), name="plate")
        )
        for x in (FALLS, 0.0)
    }


def searched(model, plate_x, valid):
    """The initial layout, and an iteration with the plate at each of `plate_x`, best first."""
    composed = model.spec.object("plate").xy[0]
    rounds = []
    for at, is_valid in (([composed], [False]), (plate_x, valid)):
        pop, count = len(at), len(model.names)
        xy = np.zeros((pop, count, 2), np.float32)
        xy[:, model.names.index("plate"), 0] = np.subtract(at, composed)
        zero = np.zeros((pop, count), np.float32)
        layouts = Layout(xy, zero, zero)
        poses = jax.tree.map(np.asarray, model.place(layouts))
        better = -np.arange(pop, dtype=np.float32)
        rests, status = np.ones((pop, count), bool), np.zeros(pop, np.int32)
        scores = Scores({}, better, rests, np.array(is_valid), status)
        rounds.append(Round(layouts, poses, scores))
    initial = finish(model, rounds[0].layouts, 0, OPTIONS)
    return model, rounds, OPTIONS, initial


def test_an_initial_layout_that_passes_wins_over_better_candidates(models):
    chosen = choose_winner(*searched(models[0.0], [STANDS], [True]))
    assert chosen.finished.passed and chosen.candidate == (0, 0) and chosen.tried == 0
    assert not np.asarray(chosen.layout.xy).any()


@pytest.mark.parametrize("plate_x", [[STANDS, 0.0], [FALLS, STANDS], [FALLS, FALLS, STANDS]])
def test_the_first_candidate_that_passes_wins(models, plate_x):
    chosen = choose_winner(*searched(models[FALLS], plate_x, [True] * len(plate_x)))
    first = plate_x.index(STANDS)
    assert chosen.finished.passed and chosen.candidate == (1, first) and chosen.tried == first + 1
    assert len(chosen.layout.xy) == 1
    plate = chosen.finished.scene.object("plate").xy[0]
    assert plate == pytest.approx(STANDS, abs=2e-3)


def test_the_result_is_never_worse_than_the_initial_layout(models, monkeypatch):
    model, rounds, o, initial = searched(models[FALLS], NEAR[:3], [True] * 3)
    assert not initial.passed
    badness = {}

    def graded(model, layouts, k, *rest):
        """The candidates' final scenes have the given badness."""
        measure = initial.measure.model_copy(update={"max_drift_m": worst[k], "s_stab": False})
        measure = measure.model_copy(
            update={"max_depth_m": 0.0, "settled_depth_m": 0.0, "displacement": {}}
        )
        found = initial._replace(measure=measure, passed=False)
        badness[k] = found.excess_over_bounds(o)
        return found

    monkeypatch.setattr(choosing, "finish", graded)
    worst = [5.0, 6.0, 7.0]
    drifts = initial.measure.model_copy(
        update={"max_drift_m": 0.05, "max_tilt_deg": 0.0, "max_depth_m": 0.0}
    )
    drifts = drifts.model_copy(update={"settled_depth_m": 0.0, "displacement": {}})
    initial = initial._replace(measure=drifts)
    chosen = choose_winner(model, rounds, o, initial)
    assert (
        min(badness.values())
        > chosen.finished.excess_over_bounds(o)
        == initial.excess_over_bounds(o)
        > 0
    )
    assert chosen.candidate == (0, 0) and chosen.finished is initial
    worst = [5.0, 0.02, 0.03]
    chosen = choose_winner(model, rounds, o, initial)
    assert chosen.candidate == (1, 1) and chosen.finished.excess_over_bounds(
        o
    ) < initial.excess_over_bounds(o)


def test_without_settling_the_best_candidate_is_returned_even_if_it_fails(models):
    model, rounds, _, _ = searched(models[FALLS], NEAR, [True] * 6)
    initial = finish(model, rounds[0].layouts, 0, UNSETTLED)
    chosen = choose_winner(model, rounds[1:], UNSETTLED, initial)
    assert not chosen.finished.passed and chosen.candidate[0] == 0 and chosen.tried == 3
    nothing = choose_winner(model, [], UNSETTLED, initial)
    assert nothing.candidate == (-1, -1) and nothing.finished is initial


def iteration(valid, reward):
    pop = len(valid)
    poses = Poses(*(np.zeros((pop, 1, *last), np.float32) for last in ((3,), (4,), (), ())))
    rests, status = np.ones((pop, 1), bool), np.zeros(pop, np.int32)
    scores = Scores({}, np.float32(reward), rests, np.array(valid), status)
    return Round(Layout.zero(pop, 1), poses, scores)


def test_valid_candidates_rank_before_all_others_and_the_reward_decides_among_them():
    first = iteration([False], [9.0])
    second = iteration([True, False, True, False, True], [1.0, 8.0, 3.0, -np.inf, np.nan])
    assert rank_candidates([first, second]) == [(1, 2), (1, 0), (0, 0), (1, 1)]
    assert rank_candidates([]) == []

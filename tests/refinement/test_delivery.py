"""Scores of delivered scenes: those of the scene at rest, each with its own run."""

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement.choosing import choose_winner
from neoworld_mjx.refinement.compiling import compile_for_search
from neoworld_mjx.refinement.delivery import final_scene_scores
from neoworld_mjx.refinement.loop import search
from neoworld_mjx.refinement.search_run import SearchRun
from neoworld_mjx.spec import Box
from tests.support import scenes

TERMS = {"s_sem", "prior", "d_pen", "d_drift"}


class Counted(NativeEngine):
    """Counts rollouts."""

    def __init__(self):
        super().__init__(threads=1)
        self.calls = 0

    def rollout(self, *args, **given):
        self.calls += 1
        return super().rollout(*args, **given)


def options(**given):
    return RefineOptions.model_validate(
        {
            "cem": {"population": 8, "iterations": 2, "hold_resting": False},
            "rollout": {"engine": "native", "duration_s": 0.2, "samples_per_object": 32},
            "check_duration_s": 0.3,
            **given,
        }
    )


@pytest.fixture(scope="module")
def searched():
    """A plate that falls off its block as composed, and does not with another start."""
    low = scenes.single("low", (Box(size=(0.1, 0.1, 0.06)), (0, 0, 0)))
    plate = scenes.single("plate", (Box(size=(0.1, 0.06, 0.02)), (0, 0, 0)))
    on_low = {"parent": "low", "z": 0.06}
    scene = scenes.on_table((low, (0, 0), 0.0, {}), (plate, (0.06, 0.0), 0.0, on_low))
    o = options()
    model = compile_for_search(scene, o)
    xy = np.zeros((1, 3, 2), np.float32)
    xy[0, model.names.index("plate"), 0] = -0.06
    zero = np.zeros((1, 3), np.float32)
    runs = [SearchRun(o, 1), SearchRun(o, 2, Layout(xy, zero, zero)), SearchRun(o, 3)]
    results = search(model, runs, NativeEngine(threads=1))
    winners = [choose_winner(model, r.rounds, o, r.initial, r.run.start, r.scene) for r in results]
    assert [w.passed for w in winners] == [True, True, True]
    assert [w.index == (0, 0) for w in winners] == [False, True, False]
    return model, results, winners


def test_every_run_gets_the_scores_of_its_own_scene(searched):
    _, results, winners = searched
    together = final_scene_scores(results, winners, NativeEngine(threads=1))
    for row, result, winner in zip(together, results, winners, strict=True):
        assert row.keys() == {"absolute", "merit"} | TERMS
        assert all(isinstance(value, float) for value in row.values())
        (alone,) = final_scene_scores([result], [winner], NativeEngine(threads=1))
        assert row == pytest.approx(alone, abs=1e-5)
    assert together[0] != pytest.approx(together[2], abs=1e-4)


def test_an_initial_layout_at_rest_is_not_rolled_out_again(searched):
    _, results, winners = searched
    engine = Counted()
    (row,) = final_scene_scores(results[1:2], winners[1:2], engine)
    assert engine.calls == 0
    scores = results[1].rounds[0].scores
    assert row["merit"] == float(scores.merit[0]) and row["absolute"] == float(scores.absolute[0])
    final_scene_scores(results, winners, engine)
    assert engine.calls == 1, "all others together"
    (by_model,) = final_scene_scores(results[1:2], winners[1:2], engine, 0.5)
    assert engine.calls == 2 and by_model["s_sem"] == 0.5


def test_the_scene_is_scored_where_it_rests(searched):
    """Another search that starts at the delivered scene finds the same overlap there."""
    _, results, winners = searched
    (row,) = final_scene_scores(results[:1], winners[:1], NativeEngine(threads=1))
    o = options()
    again = compile_for_search(winners[0].scene, o)
    (rested,) = search(again, [SearchRun(o, 0)], NativeEngine(threads=1))
    there = rested.rounds[0].scores
    assert row["d_pen"] == pytest.approx(float(there.terms["d_pen"][0]), abs=1e-3)
    assert bool(there.valid[0]) and row["d_drift"] < 0.1
    t, k = winners[0].index
    candidate = results[0].rounds[t].scores
    assert row["prior"] == pytest.approx(float(np.asarray(candidate.terms["prior"])[k]), abs=1e-6)


def test_a_score_of_a_model_replaces_the_geometric_one(searched):
    _, results, winners = searched
    engine = NativeEngine(threads=1)
    (geometric,) = final_scene_scores(results[:1], winners[:1], engine)
    (by_model,) = final_scene_scores(results[:1], winners[:1], engine, 0.125)
    assert by_model["s_sem"] == 0.125
    change = options().reward.w_sem * (0.125 - geometric["s_sem"])
    assert by_model["absolute"] - geometric["absolute"] == pytest.approx(change, abs=1e-5)


def test_without_settling_an_initial_layout_is_simulated():
    o = options(settle={"enabled": False})
    model = compile_for_search(scenes.blocks(), o)
    (result,) = search(model, [SearchRun(o, 0)], NativeEngine(threads=1))
    winner = choose_winner(model, result.rounds, o, result.initial)
    engine = Counted()
    (row,) = final_scene_scores([result], [winner], engine)
    assert engine.calls == 1 and np.isfinite(row["absolute"])

"""The loop of Algorithm 1: what is searched, kept, counted and reported, run by run."""

from dataclasses import replace

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement import loop
from neoworld_mjx.refinement.cem import initial_sigma
from neoworld_mjx.refinement.compiling import compile_for_search
from neoworld_mjx.refinement.loop import CLOCKS, search
from neoworld_mjx.refinement.optimizer import RandomSearch
from neoworld_mjx.refinement.rewards import Term
from neoworld_mjx.refinement.scorer import ScoreSource
from neoworld_mjx.refinement.search_run import SearchRun, TimeToValid
from neoworld_mjx.spec import Box
from tests.support import scenes
from tests.support.constant_scorer import ConstantScorer

ENGINE = NativeEngine(threads=1)
POP = 8


def options(iterations=2, population=POP, **given):
    cem = {"population": population, "iterations": iterations, "stop_gain": 0.0, "patience": 9}
    return RefineOptions.model_validate(
        {
            "cem": cem | given.pop("cem", {}),
            "rollout": {"engine": "native", "duration_s": 0.2, "samples_per_object": 32},
            "check_duration_s": 0.3,
            "finalists": 3,
            **given,
        }
    )


UNSETTLED = {"settle": {"enabled": False}}


def scene():
    """A plate that falls off its block, and a box that rests."""
    low = scenes.single("low", (Box(size=(0.1, 0.1, 0.06)), (0, 0, 0)))
    plate = scenes.single("plate", (Box(size=(0.1, 0.06, 0.02)), (0, 0, 0)))
    box = scenes.single("box", (Box(size=(0.06, 0.06, 0.06)), (0, 0, 0)))
    on_low = {"parent": "low", "z": 0.06}
    return scenes.on_table(
        (low, (0, 0), 0.0, {}), (plate, (0.06, 0.0), 0.0, on_low), (box, (0.0, -0.25), 0.0, {})
    )


@pytest.fixture(scope="module")
def model():
    return compile_for_search(scene(), options())


def shifted(model, x):
    """An initial layout with the plate moved."""
    xy = np.zeros((1, len(model.names), 2), np.float32)
    xy[0, model.names.index("plate"), 0] = x
    zero = np.zeros((1, len(model.names)), np.float32)
    return Layout(xy, zero, zero)


def test_each_run_has_its_own_iterations_and_ends_by_itself(model):
    lines, clock = [], {"compile": 1.0, "score": 5.0}
    o, longer = options(1, cem={"hold_resting": False}), options(3, cem={"hold_resting": False})
    runs = [SearchRun(o, 0), SearchRun(longer, 1), SearchRun(o, 2, shifted(model, -0.06))]
    short, long, resting = search(model, runs, ENGINE, clock=clock, progress=lines.append)
    assert [len(r.rounds) for r in (short, long, resting)] == [2, 4, 1]
    assert [r.rollouts for r in (short, long, resting)] == [1 + POP, 1 + 3 * POP, 1]
    assert [r.finished for r in (short, long, resting)] == [False, False, True]
    assert resting.first_valid == TimeToValid(0, 1) and 0 < resting.first_valid_s < 600
    assert lines[0] == "1 of 3 objects do not rest: plate"
    assert lines[1] == "all 3 objects rest where they were placed"
    assert [line.partition(":")[0] for line in lines[2:]] == [
        "iteration 1/1", "iteration 1/3", "iteration 2/3", "iteration 3/3"
    ]  # fmt: skip
    for line, result in zip(lines[2:4], (short, long), strict=True):
        scores = result.rounds[1].scores
        assert f"best {float(scores.absolute.max()):.3f}, elites " in line
        assert line.endswith(f" {np.mean(scores.valid):.0%} valid")
    assert clock.keys() == {"compile", "search", *CLOCKS}
    assert clock["compile"] == 1.0 and clock["score"] > 5.0 and clock["wait"] == 0.0
    spent = sum(clock[name] for name in CLOCKS) - 5.0
    assert 0 < spent <= clock["search"] and all(clock[n] > 0 for n in ("propose", "rollout"))


def test_the_first_valid_candidate_is_dated_once(model):
    (result,) = search(model, [SearchRun(options(2), 1)], ENGINE)
    valid = [bool(np.any(r.scores.valid)) for r in result.rounds]
    assert valid[0] and sum(valid) > 1, "otherwise there is nothing to confuse"
    assert not result.initial.passed and result.first_valid == TimeToValid(0, 1)
    (plain,) = search(model, [SearchRun(options(2, **UNSETTLED), 1)], ENGINE)
    valid = [bool(np.any(r.scores.valid)) for r in plain.rounds]
    assert plain.first_valid == TimeToValid(valid.index(True) + 1, POP * (valid.index(True) + 1))
    assert plain.rollouts == 2 * POP and len(plain.rounds) == 2


def test_what_rests_is_held_unless_a_run_forbids_it(model):
    (held,) = search(model, [SearchRun(options(1), 1)], ENGINE)
    fixed = [item.name for item in held.scene.spec.objects if item.fixed_base]
    assert fixed == ["low", "box"] and held.scene is not model
    moved = lambda r: np.ptp(np.asarray(r.rounds[1].layouts.xy), axis=0).max(axis=1) > 0
    assert moved(held).tolist() == [False, False, True, False]
    free = options(1, cem={"hold_resting": False})
    for runs in (
        [SearchRun(free, 1)],
        [SearchRun(options(1), 1), SearchRun(free, 1)],
        [SearchRun(options(1), 1, shifted(model, 0.001))],
        [SearchRun(options(1), 1), SearchRun(options(1), 1, shifted(model, 0.001))],
    ):
        results = search(model, runs, ENGINE)
        assert all(r.scene is model for r in results)
    assert moved(results[0]).tolist() == [False, False, True, False]
    (all_free,) = search(model, [SearchRun(free, 1)], ENGINE)
    assert moved(all_free).tolist() == [False, True, True, True]


def test_with_terms_of_ones_own_a_scene_that_passes_is_searched(model):
    term = Term("nothing", lambda s, z, r: z.yaw[:, 0] * 0.0, 1.0)
    start = shifted(model, -0.06)
    (result,) = search(model, [SearchRun(options(1), 0, start)], ENGINE, terms=[term])
    assert result.initial.passed and not result.finished and len(result.rounds) == 2
    assert not result.accept_initial and result.scene is model
    moved = np.ptp(np.asarray(result.rounds[1].layouts.xy), axis=0).max(axis=1) > 0
    assert moved.tolist() == [False, True, True, True]
    (plain,) = search(model, [SearchRun(options(1), 0, start)], ENGINE)
    assert plain.finished and plain.accept_initial and len(plain.rounds) == 1


def test_runs_with_equal_layouts_and_checks_share_the_initial_scene(model):
    o = options()
    stricter = [
        options(**{name: getattr(o, name) / 2})
        for name in ("max_depth_m", "max_drift_m", "max_tilt_deg", "check_duration_s")
    ]
    runs = [SearchRun(o, 0), SearchRun(o, 1), SearchRun(o, 2, shifted(model, -0.06))]
    lines = []
    initials = loop._initial_scenes(
        model, runs + [SearchRun(each, 0) for each in stricter], lines.append
    )
    assert initials[0] is initials[1] is not initials[2]
    assert len({id(initial) for initial in initials}) == len(lines) == 2 + len(stricter)


def test_each_iteration_is_reported_and_may_be_the_last(model):
    o = options(3, cem={"hold_resting": False})
    steps = []
    (whole,) = search(model, [SearchRun(o, 1)], ENGINE, on_iteration=steps.append)
    assert [(step.number, step.candidates) for step in steps] == [
        (0, 1),
        *((t, POP) for t in (1, 2, 3)),
    ]
    for step, round_ in zip(steps, whole.rounds, strict=True):
        absolute, valid = np.asarray(round_.scores.absolute), np.asarray(round_.scores.valid)
        assert step.best == absolute.max() and step.valid == valid.sum()
        assert step.terms["d_drift"] == round_.scores.terms["d_drift"][absolute.argmax()]
    stop_at_1 = lambda step: step.number == 1
    (stopped,) = search(model, [SearchRun(o, 1)], ENGINE, on_iteration=stop_at_1)
    assert len(stopped.rounds) == 2 and stopped.finished


def test_progress_reports_the_rate_and_the_longest_time_left(model, monkeypatch):
    reported = []
    monkeypatch.setattr(loop, "update_progress", lambda **given: reported.append(given))
    monkeypatch.setattr(loop.time, "perf_counter", lambda: 14.0)
    (done,) = search(model, [SearchRun(options(1), 1)], ENGINE)
    reported.clear()
    runs = [SearchRun(options(1), 1), SearchRun(options(4), 1)]
    loop._update_progress([done, replace(done, rollouts=3)], runs, 4.0)
    assert reported == [{"done": 2, "of": 5, "unit": "iteration", "rate": 1.2, "left_s": 15.0}]
    nothing = replace(done, rounds=done.rounds[:1], rollouts=1)
    loop._update_progress([nothing], runs[:1], 4.0)
    assert reported[-1]["done"] == 0 and reported[-1]["left_s"] == 10.0
    never = replace(done, first_valid=None)
    loop._record_first_valid(never, 4.0)
    assert never.first_valid_s == 10.0


def test_a_run_is_padded_unless_its_optimizer_is_not_ours_and_begins_at_its_own_layout(model):
    o, start = options(1, **UNSETTLED), shifted(model, -0.06)
    (result,) = search(model, [SearchRun(o, 0, start)], ENGINE)
    count = len(model.names)
    assert result.arrays.count > count
    np.testing.assert_array_equal(np.asarray(result.problem.origin.xy)[:, :count], start.xy)
    own = RandomSearch(initial_sigma(model, o.cem))
    (plain,) = search(model, [SearchRun(o, 0)], ENGINE, optimizer=own)
    assert plain.arrays.count == count


def test_a_search_ends_at_an_object_that_rests_nowhere_however_widely_it_is_drawn(model):
    narrow = {"widest": 1.0, "sigma_xy": 1e-4, "sigma_yaw_deg": 0.0, "sigma_log_scale": 0.0}
    (result,) = search(model, [SearchRun(options(3, cem=narrow, **UNSETTLED), 0)], ENGINE)
    assert result.finished and result.stuck == ("plate",) and len(result.rounds) == 1


def test_scores_of_a_model_are_those_of_the_iterations_candidates(model):
    scorer = ConstantScorer()
    (result,) = search(model, [SearchRun(options(1, **UNSETTLED), 0)], ENGINE, scorer=scorer)
    assert len(scorer.seen) == 1
    np.testing.assert_array_equal(scorer.seen[0].xy, result.rounds[0].layouts.xy)
    assert (np.asarray(result.rounds[0].scores.terms["s_sem"]) == 0.25).all()
    assert (result.score_sources[-1] == ScoreSource.SCORED).all()

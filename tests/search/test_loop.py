"""The loop of Algorithm 1: what is searched, kept, counted and reported."""

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.search.cem import initial_sigma
from neoworld_mjx.search.evaluation import CLOCKS
from neoworld_mjx.search.finishing import compile_for_search
from neoworld_mjx.search.loop import search
from neoworld_mjx.search.optimizer import RandomSearch
from neoworld_mjx.search.rewards import Term
from neoworld_mjx.search.scorer import ScoreSource
from neoworld_mjx.spec import Box
from tests.support import scenes
from tests.support.constant_scorer import ConstantScorer

ENGINE = NativeEngine(threads=1)
POP = 8
UNSETTLED = {"settle": {"enabled": False}}


def options(iterations=2, population=POP, **given):
    cem = {"population": population, "iterations": iterations, "stop_gain": 0.0}
    return RefineOptions.model_validate(
        {
            "cem": cem | given.pop("cem", {}),
            "rollout": {"engine": "native", "duration_s": 0.2, "samples_per_object": 32},
            "check_duration_s": 0.3,
            "finalists": 3,
            **given,
        }
    )


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


def test_a_line_names_the_objects_that_rest_in_no_candidate(model):
    lines = []
    narrow = {"widest": 1.0, "sigma_xy": 1e-4}
    search(model, options(1, cem=narrow), ENGINE, seed=1, clock={}, progress=lines.append)
    assert lines[-1].endswith(f"0 of {POP} candidates valid; in none did plate rest")


def moved(result):
    """Return a mask of the objects that the first search iteration moved."""
    return (np.ptp(np.asarray(result.rounds[1].layouts.xy), axis=0).max(axis=1) > 0).tolist()


def test_iterations_are_counted_reported_and_timed(model):
    lines, steps, clock = [], [], {"compile": 1.0, "score": 5.0}
    o = options(3, cem={"hold_resting": False})
    reports = {"progress": lines.append, "on_iteration": steps.append}
    whole = search(model, o, ENGINE, seed=1, clock=clock, **reports)
    assert len(whole.rounds) == 4 and whole.rollouts == 1 + 3 * POP
    assert lines[0] == "1 of 3 objects do not rest: plate"
    assert [line.partition(":")[0] for line in lines[1:]] == [f"iteration {t}/3" for t in (1, 2, 3)]
    assert all(f" of {POP} candidates valid" in line for line in lines[1:])
    assert [(s.number, s.candidates) for s in steps] == [(0, 1), (1, POP), (2, POP), (3, POP)]
    for step, round_ in zip(steps, whole.rounds, strict=True):
        reward, valid = np.asarray(round_.scores.reward), np.asarray(round_.scores.valid)
        assert step.best == reward.max() and step.valid == valid.sum()
        assert step.terms["d_drift"] == round_.scores.terms["d_drift"][reward.argmax()]
    assert clock.keys() == {"compile", "search", "to_valid", *CLOCKS}
    assert clock["compile"] == 1.0 and clock["score"] > 5.0 and clock["wait"] == 0.0
    assert 0 < clock["rollout"] < clock["search"] and 0 < clock["to_valid"] < clock["search"]
    stopped = search(model, o, ENGINE, seed=1, on_iteration=lambda step: step.number == 1)
    assert len(stopped.rounds) == 2


def test_an_initial_layout_that_passes_ends_the_search_unless_terms_are_added(model):
    lines, start = [], shifted(model, -0.06)
    plain = search(model, options(1), ENGINE, start=start, progress=lines.append)
    assert plain.accept_initial and len(plain.rounds) == plain.rollouts == 1
    assert lines == ["all 3 objects rest where they were placed"]
    term = Term("nothing", lambda s, z, r: z.yaw[:, 0] * 0.0, 1.0)
    result = search(model, options(1), ENGINE, start=start, terms=[term])
    assert result.initial.passed and len(result.rounds) == 2
    assert not result.accept_initial and result.evaluation.scene is model
    assert moved(result) == [False, True, True, True]


def test_what_rests_is_held_unless_the_options_or_a_start_forbid_it(model):
    held = search(model, options(1), ENGINE, seed=1)
    fixed = [item.name for item in held.evaluation.scene.spec.objects if item.fixed_base]
    assert fixed == ["low", "box"] and moved(held) == [False, False, True, False]
    started = search(model, options(1), ENGINE, seed=1, start=shifted(model, 0.001))
    assert started.evaluation.scene is model and moved(started) == [False, False, True, False]
    free = search(model, options(1, cem={"hold_resting": False}), ENGINE, seed=1)
    assert free.evaluation.scene is model and moved(free) == [False, True, True, True]


def test_scenes_are_padded_unless_the_optimizer_is_passed(model):
    o, start = options(1, **UNSETTLED), shifted(model, -0.06)
    result, count = search(model, o, ENGINE, start=start), len(model.names)
    assert result.evaluation.arrays.count > count
    np.testing.assert_array_equal(
        np.asarray(result.evaluation.problem.origin.xy)[:, :count], start.xy
    )
    own = RandomSearch(initial_sigma(model, o.cem))
    assert search(model, o, ENGINE, optimizer=own).evaluation.arrays.count == count


def test_scores_of_a_model_are_those_of_the_iterations_candidates(model):
    scorer = ConstantScorer()
    result = search(model, options(1, **UNSETTLED), ENGINE, scorer=scorer)
    assert len(scorer.seen) == 1
    np.testing.assert_array_equal(scorer.seen[0].xy, result.rounds[0].layouts.xy)
    assert (np.asarray(result.rounds[0].scores.terms["s_sem"]) == 0.25).all()
    assert (result.rounds[-1].s_sem_from == ScoreSource.SCORED).all()

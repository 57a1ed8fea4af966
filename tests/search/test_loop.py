"""The loop of Algorithm 1: what is searched, kept, counted and reported."""

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.search import refine
from neoworld_mjx.search import scene_refinement as module
from neoworld_mjx.search.cem import initial_sigma
from neoworld_mjx.search.evaluation import CLOCKS, open_evaluation
from neoworld_mjx.search.loop import search
from neoworld_mjx.search.optimizer import RandomSearch
from neoworld_mjx.search.rewards import Term
from neoworld_mjx.search.scorer import ScoreSource
from neoworld_mjx.search.searched_scene import compile_for_search
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
    low = scenes.block("low", (0.1, 0.1, 0.06))
    plate = scenes.block("plate", (0.1, 0.06, 0.02))
    box = scenes.block("box", (0.06, 0.06, 0.06))
    on_low = {"parent": "low", "z": 0.06}
    return scenes.on_table(
        (low, (0, 0), 0.0, {}), (plate, (0.06, 0.0), 0.0, on_low), (box, (0.0, -0.25), 0.0, {})
    )


@pytest.fixture(scope="module")
def model():
    return compile_for_search(scene(), options())


def run(model, o, *, seed=1, terms=(), optimizer=None, resting=None, clock=None, **reports):
    evaluation = open_evaluation(
        model, o, ENGINE, resting=resting, terms=terms, optimizer=optimizer, clock=clock
    )
    return evaluation, search(evaluation, seed=seed, **reports)


def moved(layouts):
    """Return a mask of the objects whose places vary between candidates [pop, object, 2]."""
    return (np.ptp(np.asarray(layouts), axis=0).max(axis=1) > 0).tolist()


def test_a_line_names_the_objects_that_rest_in_no_candidate(model):
    lines = []
    narrow = {"widest": 1.0, "sigma_xy": 1e-4}
    run(model, options(1, cem=narrow), progress=lines.append)
    assert lines[-1].endswith(f"0 of {POP} candidates valid; in none did plate rest")


def test_iterations_are_counted_reported_and_timed(model):
    lines, steps, clock = [], [], {"compile": 1.0, "score": 5.0}
    reports = {"progress": lines.append, "on_iteration": steps.append}
    _, rounds = run(model, options(3), clock=clock, **reports)
    assert [line.partition(":")[0] for line in lines] == [f"iteration {t}/3" for t in (1, 2, 3)]
    assert all(f" of {POP} candidates valid" in line for line in lines)
    assert [(s.number, s.candidates) for s in steps] == [(1, POP), (2, POP), (3, POP)]
    for step, round_ in zip(steps, rounds, strict=True):
        reward, valid = np.asarray(round_.scores.reward), np.asarray(round_.scores.valid)
        assert step.best == reward.max() and step.valid == valid.sum()
        assert step.terms["d_drift"] == round_.scores.terms["d_drift"][reward.argmax()]
    assert clock.keys() == {"compile", "to_valid", *CLOCKS}
    assert clock["compile"] == 1.0 and clock["score"] > 5.0 and clock["wait"] == 0.0
    assert clock["rollout"] > 0 and clock["to_valid"] > 0
    _, stopped = run(model, options(3), on_iteration=lambda step: step.number == 1)
    assert len(stopped) == 1


def test_scenes_are_padded_unless_the_optimizer_is_passed(model):
    o, count = options(1, **UNSETTLED), len(model.names)
    assert open_evaluation(model, o, ENGINE).arrays.count > count
    own = RandomSearch(initial_sigma(model, o.cem))
    assert open_evaluation(model, o, ENGINE, optimizer=own).arrays.count == count


def test_resting_objects_are_not_sampled(model):
    resting = np.array([name == "box" for name in model.names])
    _, (round_,) = run(model, options(1), resting=resting)
    assert moved(round_.layouts.xy) == [False, True, True, False]


def test_scores_of_a_model_are_those_of_the_iterations_candidates(model):
    scorer = ConstantScorer()
    _, rounds = run(model, options(1, **UNSETTLED), scorer=scorer)
    assert len(scorer.seen) == 1
    np.testing.assert_array_equal(scorer.seen[0].xy, rounds[0].layouts.xy)
    assert (np.asarray(rounds[0].scores.terms["s_sem"]) == 0.25).all()
    assert (rounds[-1].s_sem_from == ScoreSource.SCORED).all()


def test_what_rests_is_fixed_unless_the_options_or_a_term_forbid_it(monkeypatch):
    """Objects that rest are fixed in the searched scene, unless a user has a term."""
    searched = []
    monkeypatch.setattr(
        module,
        "open_evaluation",
        lambda model, *args, **given: (
            searched.append(model) or open_evaluation(model, *args, **given)
        ),
    )
    fixed = lambda: [item.name for item in searched[-1].spec.objects if item.fixed_base]
    resting = refine(scene(), options(1), seed=1, engine=ENGINE)
    assert fixed() == ["low", "box"] and moved(resting.history["xy"][0]) == [
        False,
        False,
        True,
        False,
    ]
    free = refine(scene(), options(1, cem={"hold_resting": False}), seed=1, engine=ENGINE)
    assert not fixed() and moved(free.history["xy"][0]) == [False, True, True, True]
    term = Term("nothing", lambda s, z, r: z.yaw[:, 0] * 0.0, 1.0)
    rested = scenes.changed(scene(), "plate", xy=(0.0, 0.0))
    result = refine(rested, options(1), terms=[term], engine=ENGINE)
    assert result.before.s_stab and result.iterations == 1 and not fixed()
    assert moved(result.history["xy"][0]) == [False, True, True, True]

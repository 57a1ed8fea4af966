import math
import sys

import jax
import numpy as np
import pytest

from neoworld_mjx.compilations import compilations
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.scene_arrays import pad_scene
from neoworld_mjx.refinement.algorithm import propose, update
from neoworld_mjx.refinement.batching import map_runs
from neoworld_mjx.refinement.evaluation import Evaluation
from neoworld_mjx.refinement.loop import CLOCKS, _initial_scenes, _initialize_runs, search
from neoworld_mjx.refinement.objective import evaluate
from neoworld_mjx.refinement.scene_refinement import compile_for_search, refine
from neoworld_mjx.refinement.search_run import SearchRun
from neoworld_mjx.sweeps import winners as module
from neoworld_mjx.sweeps.run_rows import summaries
from neoworld_mjx.sweeps.winners import choose_in_processes, processes_are_faster, winners
from tests.support.scenes import noisy_layouts, stored_scene

ENGINE = NativeEngine()
INITIAL = {"xy": 0.08, "yaw": math.radians(20.0), "log_scale": 0.12}


def options(w_drift=1.0, *, population=8, iterations=4, **more):
    cem = {
        "population": population,
        "iterations": iterations,
        "elite_ratio": 0.25,
        "hold_resting": False,
        "patience": 4,
    } | more.pop("cem", {})
    return RefineOptions.model_validate(
        {
            "cem": cem,
            "settle": {"enabled": False} | more.pop("settle", {}),
            "reward": {"w_drift": w_drift, **more},
            "rollout": {"engine": "native", "duration_s": 0.2, "samples_per_object": 32},
            "check_duration_s": 0.2,
            "finalists": 3,
        }
    )


@pytest.fixture(scope="module")
def model():
    return compile_for_search(stored_scene("crowded_3"), options())


def started(model, settings, seeds):
    starts = {seed: noisy_layouts(model, 1, seed=seed, **INITIAL) for seed in seeds}
    return [SearchRun(o, seed, starts[seed]) for o in settings for seed in seeds]


def same_as_alone(model, runs):
    """Compare with separate refinements; return those."""
    found = search(model, runs, ENGINE, keep_all=False)
    alone = []
    for run, result in zip(runs, found, strict=True):
        one = refine(model, run.options, seed=run.seed, start=run.start, engine=ENGINE)
        (chosen,) = winners(model.spec, run.options, model, [result])
        t, k = chosen.index
        scores = result.rounds[t].scores
        # Sums of all candidates, of which only those that may win are kept.
        assert result.summaries == summaries(one.history)
        assert (len(result.rounds), result.rollouts) == (one.iterations, one.rollouts)
        ended = (t, chosen.tried, chosen.passed)
        assert ended == (one.winner[0], one.finalists_tried, one.passed)
        for a, b in zip(jax.tree.leaves(chosen.layout), jax.tree.leaves(one.layout), strict=True):
            np.testing.assert_array_equal(a, b)
        assert chosen.measure == one.measure
        for name in ("reward", "absolute"):
            assert getattr(scores, name)[k] == one.history[name][one.winner]
        for name, values in scores.terms.items():
            assert values[k] == one.history[name][one.winner]
        alone.append(one)
    return alone


def test_runs_in_one_computation_equal_separate_refinements(model):
    runs = started(model, [options(0.25), options(4.0, cem={"sigma_xy": 0.03})], (0, 1))
    alone = same_as_alone(model, runs)
    # Otherwise there would be nothing to confuse.
    assert len({np.asarray(one.layout.xy).tobytes() for one in alone}) >= 3
    assert any(one.winner[0] > 0 for one in alone)


def test_stopping_does_not_affect_other_runs(model):
    settings = [
        options(cem={"stop_gain": 1e3, "patience": 1}),
        options(cem={"iterations": 2}),
        options(cem={"stop_gain": 0.0}, w_prior=0.0),
    ]
    alone = same_as_alone(model, started(model, settings, (0,)))
    assert len({one.iterations for one in alone}) > 1


def test_settled_and_searched_runs_equal_separate_refinements(model):
    o = options(population=8, iterations=3, settle={"enabled": True, "duration_s": 1.5})
    noisy = noisy_layouts(model, 1, seed=0, **INITIAL)
    off_its_box = np.zeros_like(noisy.xy)
    off_its_box[0, model.names.index("upper_2")] = (-0.12, 0.0)
    away = Layout(off_its_box, noisy.yaw, noisy.log_scale)
    alone = same_as_alone(model, [SearchRun(o, 0, noisy), SearchRun(o, 1, away)])
    assert [one.iterations > 1 for one in alone] == [False, True]


@pytest.fixture(scope="module")
def beside():
    """Six objects, one of them beside the box that should carry it."""
    scene = stored_scene("crowded_6")
    objects = [
        item.model_copy(update={"xy": (-0.09, 0.0)}) if item.name == "upper_2" else item
        for item in scene.objects
    ]
    scene = scene.model_copy(update={"objects": tuple(objects)})
    return compile_for_search(scene, options())


def test_held_objects_are_those_of_separate_refinements(beside):
    settings = [
        options(w, population=8, iterations=2, cem={"hold_resting": True}, settle={"enabled": True})
        for w in (0.5, 2.0)
    ]
    alone = same_as_alone(beside, [SearchRun(o, 0) for o in settings])
    assert all(0 < len(one.kept) < 6 and one.iterations > 1 for one in alone)


def test_objects_are_free_for_a_run_that_holds_none(beside):
    held, free = (
        options(population=8, iterations=1, cem={"hold_resting": hold}, settle={"enabled": True})
        for hold in (True, False)
    )
    results = search(beside, [SearchRun(held, 0), SearchRun(free, 0)], ENGINE)
    assert all(result.scene is beside for result in results)
    still = [np.ptp(np.asarray(r.rounds[1].layouts.xy), axis=0).max(axis=1) == 0 for r in results]
    assert still[0].sum() > 1 and still[1].sum() == 1, "the table does not move"


@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    [
        {"cem": {"credit": "object", "zero_candidate": False, "smoothing": 0.3}},
        {"cem": {"credit": "scene", "widest": 1.0, "sigma_xy": 0.08}},
        {"normalisation": "iteration", "w_prior": 0.0},
        {"population": 8, "cem": {"hold_resting": True}, "settle": {"enabled": True}},
    ],
    ids=["object", "scene", "iteration", "settle"],
)
def test_other_programs_are_as_alone_too(model, more):
    runs = started(model, [options(0.5, **more), options(2.0, **more)], (0, 1))
    same_as_alone(model, runs)


def test_vmap_over_tiles_agrees_up_to_rounding(model):
    runs = started(model, [options(0.5), options(2.0)], (0, 1))[:3]
    clock = dict.fromkeys(CLOCKS, 0.0)
    initials = _initial_scenes(model, runs, None)
    result = {}
    # Three runs in tiles of two: the second tile is filled up.
    for tile in (1, 2):
        scenes, o = (model, model, pad_scene(model)), runs[0].options
        evaluation = Evaluation(*scenes, ENGINE, o, len(runs), tile, clock, 0.0)
        opened = _initialize_runs(evaluation, runs, initials, (), None, builtin_only=True)
        rows = [(r.problem, r.state, runs[0].options.cem.population) for r in opened]
        layouts = map_runs(propose, model, rows, tile)
        placed = [jax.device_get(p) for p in evaluation.place(layouts)]
        rollouts = [ENGINE.rollout(model, p.poses, duration=0.2) for p in placed]
        rows = [
            (z, p, rollout, r.problem.objective)
            for z, p, rollout, r in zip(layouts, placed, rollouts, opened, strict=True)
        ]
        scores = map_runs(evaluate, model, rows, tile)
        rows = [(r.problem, r.state, z, s) for r, z, s in zip(opened, layouts, scores, strict=True)]
        result[tile] = (layouts, scores, map_runs(update, model, rows, tile))
    pairs = zip(jax.tree.leaves(result[1]), jax.tree.leaves(result[2]), strict=True)
    for a, b in pairs:
        np.testing.assert_allclose(a, b, atol=2e-6)


def counted(model, runs):
    before = compilations()
    search(model, runs, ENGINE, keep_all=False)
    return compilations() - before


def test_more_points_need_no_more_compilations(model):
    # No other test has this population, whose programs are compiled here.
    few, many = (
        started(model, [options(0.5 + k, population=9, iterations=1) for k in range(n)], seeds)
        for n, seeds in ((2, (0,)), (3, (0, 1)))
    )
    assert counted(model, few) > 0
    assert counted(model, many) == 0


@pytest.mark.slow
def test_32_points_and_4_seeds_compile_once_and_are_as_alone(model):
    axes = [(a, b) for a in np.linspace(0.25, 4, 8) for b in (0.02, 0.04, 0.06, 0.08)]
    settings = [options(a, cem={"sigma_xy": b}) for a, b in axes]
    runs = started(model, settings, (0, 1, 2, 3))
    assert len(runs) == 128
    counted(model, [runs[0], runs[-1]])
    assert counted(model, runs) == 0
    same_as_alone(model, runs)


def test_processes_choose_the_winners_that_threads_choose(model):
    results = search(model, started(model, [options(2.0)], (0, 1, 2)), ENGINE, keep_all=False)
    threads = winners(model.spec, options(), model, results)
    processes = choose_in_processes(model.spec, options(), results, 2)
    assert processes is not None
    for one, other in zip(threads, processes, strict=True):
        assert (one.index, one.tried, one.measure) == (other.index, other.tried, other.measure)
        assert one.before == other.before
        for a, b in zip(jax.tree.leaves(one.layout), jax.tree.leaves(other.layout), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_processes_know_held_objects(beside):
    o = options(population=8, iterations=2, cem={"hold_resting": True}, settle={"enabled": True})
    results = search(beside, [SearchRun(o, seed) for seed in (0, 1)], ENGINE, keep_all=False)
    assert results[0].scene is not beside
    threads = winners(beside.spec, o, beside, results)
    processes = choose_in_processes(beside.spec, o, results, 1)
    assert processes is not None
    for one, other in zip(threads, processes, strict=True):
        assert (one.index, one.measure) == (other.index, other.measure)


def test_a_process_that_fails_leaves_the_checks_to_threads(model, monkeypatch):
    results = search(model, started(model, [options(2.0)], (0,)), ENGINE, keep_all=False)
    lines = []
    monkeypatch.setattr(module, "report", lines.append)
    monkeypatch.setattr(module, "processes_are_faster", lambda runs, cores: True)
    monkeypatch.setattr(sys, "executable", "/bin/false")
    (winner,) = winners(model.spec, options(), model, results)
    assert winner.tried > 0
    assert lines == [
        "a process of final checks failed (exit status 1); checking in threads instead"
    ]


def test_processes_are_faster_for_many_runs_on_many_cores():
    assert not processes_are_faster(10_000, 2)
    assert not processes_are_faster(8, 16)
    assert processes_are_faster(512, 16)

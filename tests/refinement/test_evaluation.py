"""Placement, settling, rollout and scores of populations, on padded arrays, run by run."""

import itertools
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.engine import zero_duration_rollout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.placed import measure_settled
from neoworld_mjx.physics.scene_arrays import pad_objects, pad_scene
from neoworld_mjx.refinement import evaluation as module
from neoworld_mjx.refinement.compiling import compile_for_search
from neoworld_mjx.refinement.evaluation import Evaluation
from neoworld_mjx.refinement.loop import CLOCKS, _initial_scenes, _initialize_runs
from neoworld_mjx.refinement.objective import evaluate
from neoworld_mjx.refinement.search_run import SearchRun
from neoworld_mjx.spec import world_poses
from tests.support.scenes import noisy_layouts, stored_scene

POP = 8
ENGINE = NativeEngine(threads=1)


def options(*, settled=True):
    return RefineOptions.model_validate(
        {
            "cem": {"population": POP, "iterations": 1, "hold_resting": False},
            "settle": {"enabled": settled, "duration_s": 0.4},
            "rollout": {"engine": "native", "duration_s": 0.2, "samples_per_object": 32},
            "check_duration_s": 0.1,
        }
    )


@pytest.fixture(scope="module")
def model():
    return compile_for_search(stored_scene("crowded_2"), options())


def opened(model, o, starts=(None, None)):
    """An evaluation of two runs on a padded scene, and the runs."""
    runs = [SearchRun(o, seed, start) for seed, start in enumerate(starts)]
    clock = dict.fromkeys(CLOCKS, 0.0)
    evaluation = Evaluation(model, *[pad_scene(model)] * 2, ENGINE, o, len(runs), 1, clock, 0.0)
    initials = _initial_scenes(model, runs, None)
    return evaluation, _initialize_runs(evaluation, runs, initials, (), None, builtin_only=True)


@pytest.fixture(scope="module")
def settled(model):
    return opened(model, options(), (None, noisy_layouts(model, 1, seed=3, xy=0.02, yaw=0.1)))


def populations(evaluation, model):
    count = evaluation.arrays.count
    return [pad_objects(noisy_layouts(model, POP, seed=k, xy=0.02), count) for k in range(2)]


def assert_near(a, b):
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-5), a, b)


def test_populations_are_measured_where_they_settled(model, settled):
    evaluation, _ = settled
    layouts = populations(evaluation, model)
    evaluation.clock.update(dict.fromkeys(CLOCKS, 0.0))
    placed = evaluation.place(layouts)
    assert evaluation.clock["settle"] > 0 and evaluation.clock["score"] > 0
    assert evaluation.clock["rollout"] == evaluation.clock["propose"] == 0
    for z, candidates in zip(layouts, placed, strict=True):
        start = jax.device_get(evaluation.arrays.place(z))
        moved = np.abs(np.asarray(candidates.poses.pos) - start.pos).max(axis=(1, 2))
        assert (moved > 1e-5).all()
        assert_near(candidates, measure_settled(evaluation.arrays, start, candidates.poses))
        assert np.asarray(candidates.settled).any()
    assert not np.array_equal(placed[0].poses.pos, placed[1].poses.pos)


def test_without_settling_they_are_measured_as_placed(model):
    evaluation, _ = opened(model, options(settled=False))
    layouts = populations(evaluation, model)
    placed = evaluation.place(layouts)
    for z, candidates in zip(layouts, placed, strict=True):
        assert_near(candidates.poses, evaluation.arrays.place(z))
        assert not np.asarray(candidates.settled).any()


def test_each_run_is_scored_with_its_own_layouts_motion_and_objective(model, settled):
    evaluation, runs = settled
    layouts = populations(evaluation, model)
    placed = evaluation.place(layouts)
    before = dict(evaluation.clock)
    rollouts = evaluation.roll_out(placed)
    assert evaluation.clock["rollout"] > before["rollout"]
    assert evaluation.clock["score"] == before["score"]
    scores = evaluation.score(runs, layouts, placed, rollouts)
    assert evaluation.clock["score"] > before["score"]
    assert all(len(r.pos) == POP and r.pos.shape[2] == model.count for r in rollouts)
    for run, z, candidates, found in zip(runs, layouts, placed, scores, strict=True):
        (alone,) = evaluation.roll_out([candidates])
        (again,) = evaluation.score([run], [z], [candidates], [alone])
        assert_near(found, again)
    assert not np.array_equal(scores[0].reward, scores[1].reward)


def test_scores_of_a_model_replace_the_geometric_ones(model, settled):
    evaluation, runs = settled
    layouts = populations(evaluation, model)[:1]
    placed = evaluation.place(layouts)
    rollouts = evaluation.roll_out(placed)
    given = np.linspace(0, 1, POP, dtype=np.float32)
    (geometric,) = evaluation.score(runs[:1], layouts, placed, rollouts)
    (by_model,) = evaluation.score(runs[:1], layouts, placed, rollouts, given)
    np.testing.assert_array_equal(by_model.terms["s_sem"], given)
    weight = runs[0].run.options.reward.w_sem
    change = weight * (given - np.asarray(geometric.terms["s_sem"]))
    np.testing.assert_allclose(by_model.absolute - geometric.absolute, change, atol=1e-5)


def test_before_physics_nothing_has_moved(model, settled):
    evaluation, runs = settled
    layouts = populations(evaluation, model)[0]
    (placed,) = evaluation.place([layouts])
    scores = evaluation.before_physics(runs[0], layouts, placed)
    still = zero_duration_rollout(evaluation.arrays, placed.poses)
    assert_near(
        scores, evaluate(evaluation.arrays, layouts, placed, still, runs[0].problem.objective)
    )
    assert isinstance(scores.reward, np.ndarray)


def test_an_initial_layout_is_scored_where_it_exactly_rests(model, settled):
    evaluation, runs = settled
    rounds = evaluation.score_initials(runs)
    assert len(rounds) == 2
    for run, round_ in zip(runs, rounds, strict=True):
        exact = world_poses(run.initial.scene)
        for k, name in enumerate(model.names):
            np.testing.assert_allclose(round_.poses.pos[0, k], exact[name].pos, atol=1e-6)
            np.testing.assert_allclose(round_.poses.quat[0, k], exact[name].quat, atol=1e-6)
        scale = np.exp(np.asarray(run.problem.origin.log_scale))[:, : model.count]
        np.testing.assert_allclose(round_.poses.scale, scale, rtol=1e-6)
        assert np.asarray(round_.poses.pos).dtype == np.float32
        assert round_.layouts.xy.shape == (1, model.count, 2)
        assert round_.scores.drift.shape == (1, model.count)
        assert round_.scores.depth.shape == round_.scores.rested.shape == (1, model.count)
        assert round_.scores.reward.shape == (1,) and np.isfinite(round_.scores.reward).all()
        # At rest nothing overlaps or moves, whatever the layout was before.
        assert float(round_.scores.terms["d_drift"][0]) < 0.5 and bool(round_.scores.valid[0])
    assert not np.array_equal(rounds[0].poses.pos, rounds[1].poses.pos)


def test_one_candidate_is_measured_against_the_pose_that_it_settled_from(model, settled):
    evaluation, runs = settled
    rests = [evaluation.settled_poses(r.initial.scene, r.problem.origin) for r in runs]
    layouts = [r.problem.origin for r in runs]
    starts = [jax.tree.map(np.array, rest) for rest in rests]
    starts[1].pos[:, 1:, 0] += 0.5
    same, moved = evaluation.score_each(runs, layouts, starts, rests)
    (alone,) = evaluation.score_each(runs[1:], layouts[1:], rests[1:], rests[1:])
    assert float(moved.merit[0]) < float(alone.merit[0]), "displacement by settling costs"
    np.testing.assert_allclose(moved.terms["d_pen"], alone.terms["d_pen"], atol=1e-6)
    assert len(same.reward) == len(moved.reward) == 1
    (known,) = evaluation.score_each(
        runs[:1], layouts[:1], rests[:1], rests[:1], np.float32([0.25])
    )
    assert float(known.terms["s_sem"][0]) == 0.25


def test_accelerators_compute_what_a_cpu_computes(model, settled, monkeypatch):
    evaluation, runs = settled
    layouts = populations(evaluation, model)

    def everything():
        placed = evaluation.place(layouts)
        return placed, evaluation.score_initials(runs)

    on_cpu = everything()
    monkeypatch.setattr(module, "computes_on_cpu", lambda: False)
    calls, mapped = [], module.map_runs

    def noted(fn, scene, rows, tile, population=0):
        calls.append((fn, tile, population))
        return mapped(fn, scene, rows, tile, population)

    monkeypatch.setattr(module, "map_runs", noted)
    assert_near(everything(), on_cpu)
    assert {measure_settled, module.SceneArrays.place} <= {fn for fn, *_ in calls}
    assert {call[1:] for call in calls} == {(1, POP)}


def test_the_time_of_each_step_is_what_has_passed_since_it_began(model, settled, monkeypatch):
    evaluation, runs = settled
    layouts = populations(evaluation, model)
    ticks = (2.0**k for k in itertools.count())  # 1, 2, 4, ... s: no interval is like another.
    monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=lambda: next(ticks)))
    evaluation.clock.update(dict.fromkeys(CLOCKS, 0.0))
    placed = evaluation.place(layouts)
    assert (evaluation.clock["settle"], evaluation.clock["score"]) == (2.0, 5.0)
    rollouts = evaluation.roll_out(placed)
    evaluation.score(runs, layouts, placed, rollouts)
    assert (evaluation.clock["rollout"], evaluation.clock["score"]) == (16.0, 69.0)

"""The refinement benchmark: its scenes are valid, its starts are not, and its rows are of real
runs.
"""

import numpy as np
import pytest
from neoworld_bench import refine_scenes
from neoworld_bench.engines.table_scenes import noisy_layouts
from neoworld_bench.methods.baselines import OneByOne, algorithm1
from neoworld_bench.refine import refinements, summary

from neoworld_mjx.config import CEMOptions, RefineOptions, RolloutOptions
from neoworld_mjx.errors import EngineError
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.physics.exact import snap_exactly
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement.scene_refinement import compile_for_search
from neoworld_mjx.refinement.semantic import reprojection_error

SMALL = RefineOptions(
    cem=CEMOptions(population=24, iterations=2, first=8, batch=8),
    rollout=RolloutOptions(duration_s=0.4, samples_per_object=64),
)


@pytest.mark.parametrize("name", refine_scenes.SCENES)
def test_the_truth_holds_and_fits_its_photograph(name):
    scene = refine_scenes.photographed(name)
    assert passes(measured(snap_exactly(scene), SMALL), SMALL)
    assert 3 <= sum(not obj.environment for obj in scene.objects) <= 10
    camera = scene.camera
    for obj in scene.objects:
        if not obj.environment:
            x0, y0, x1, y1 = obj.box2d.as_tuple()
            assert -10 < x0 < x1 < camera.width + 10 and -10 < y0 < y1 < camera.height_px + 10
    assert refine_scenes.photographed(name) == scene


def test_starts_are_as_far_off_as_is_said_and_hardly_any_holds():
    scene = compile_for_search(refine_scenes.photographed("tower"), SMALL)
    starts = [refine_scenes.start(scene, seed) for seed in range(60)]
    moves = np.asarray(scene.optimised)
    logs = np.concatenate([np.asarray(s.log_scale[0])[moves] for s in starts])
    yaws = np.concatenate([np.asarray(s.yaw[0])[moves] for s in starts])
    assert np.std(logs) == pytest.approx(0.12, rel=0.15)
    assert np.degrees(np.std(yaws)) == pytest.approx(20, rel=0.15)
    held = [passes(measured(snap_exactly(scene.apply(s, 0)), SMALL), SMALL) for s in starts[:6]]
    assert sum(held) <= 1
    fit = [float(reprojection_error(scene, scene.place(s))[0]) for s in starts]
    truth = type(starts[0]).zero(1, len(moves))
    assert float(reprojection_error(scene, scene.place(truth))[0]) < 0.5 * min(fit)


def test_the_sequential_engine_says_what_native_says():
    scene = compile_for_search(refine_scenes.photographed("tower"), SMALL)
    layouts = noisy_layouts(scene, 3, seed=1)
    first, second = (
        e.rollout(scene, scene.place(layouts), duration=0.1) for e in (OneByOne(), NativeEngine())
    )
    assert np.allclose(first.pos, second.pos, atol=1e-5)
    assert np.array_equal(first.status, second.status) and np.array_equal(first.steps, second.steps)


@pytest.mark.slow
def test_rows_and_their_summary():
    pytest.importorskip("evosax", reason="baseline cma_es needs the extra baselines")
    rows = list(refinements(("tower",), seeds=1, options=SMALL))
    by = {row.method: row for row in rows}
    assert set(by) == {"ours", "ours/plain", "algorithm1"} | {
        f"{m}{how}" for m in ("random", "cma_es") for how in ("", "/plain")
    }
    assert by["ours"].valid and not by["ours"].open_loop_valid
    assert by["ours"].xy_error_end_m < by["ours"].xy_error_start_m
    assert 0 <= by["random"].rollouts - by["ours"].rollouts < by["random"].iterations
    assert by["cma_es"].rollouts % 16 == 0
    assert by["algorithm1"].rollouts == 48 and by["algorithm1"].pruned == 0
    reported = summary(rows)
    assert reported["n"] == 1 and reported["valid_rate"] == 1.0
    assert reported["baselines"]["algorithm1"]["n"] == 1
    assert reported["reward_higher_on"]["random/plain"]["of"] == 1
    expected = {"open_loop_valid_rate", "time_to_valid_s", "time_total_s", "xy_error_start_m"}
    expected |= {"xy_error_end_m", "yaw_error_start_deg", "yaw_error_end_deg", "scale_error_start"}
    expected |= {"scale_error_end", "mean_log_scale", "rollouts"}
    assert expected <= set(reported) and expected <= set(reported["baselines"]["cma_es"])


def test_an_unknown_scene_is_named():
    with pytest.raises(EngineError, match="tower"):
        list(refinements(("towr",), seeds=1))


def test_algorithm_1_keeps_what_is_to_be_equal():
    o = algorithm1(SMALL)
    assert (o.cem.population, o.cem.iterations) == (24, 2)
    assert o.reward.model_copy(update={"normalisation": "fixed"}) == SMALL.reward
    assert not (o.cem.prune or o.descent.warm_steps or o.rollout.early_stop)


@pytest.mark.parametrize("name", refine_scenes.LARGE)
def test_however_small_a_thing_looks_it_has_a_box(name):
    scene = refine_scenes.photographed(name)
    assert len(scene.objects) == int(name.removeprefix("crowd_")) + 1
    for obj in scene.objects:
        x0, y0, x1, y1 = obj.box2d.as_tuple()
        assert min(x1 - x0, y1 - y0) >= 1.0 - 1e-9

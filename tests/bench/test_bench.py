"""Engine suites: scenes, throughput, agreement, kernels, and their commands."""

import json
import math
import xml.etree.ElementTree as ET

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from neoworld_bench.engines import throughput as timing
from neoworld_bench.engines.agreement import ModelRow, VerdictRow, agreed, agreement
from neoworld_bench.engines.agreement_scenes import AGREEMENT
from neoworld_bench.engines.growth import growth, write_chart
from neoworld_bench.engines.kernel_times import KernelRow, dispatch, kernels
from neoworld_bench.engines.penetration import KINDS, accuracy, random_pairs
from neoworld_bench.engines.table_scenes import COUNTS, Noise, crowded, noisy_layouts
from neoworld_bench.engines.throughput import PhysicsRow, Task, measure, physics
from neoworld_bench.engines.verdicts import compare, motion, naive_loop

from neoworld_mjx import cli
from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.engine import RolloutStatus
from neoworld_mjx.physics.native import NativeEngine
from tests.support.scenes import compile_scene


@pytest.fixture(scope="module")
def three():
    scene = compile_scene(crowded(3))
    return scene, noisy_layouts(scene, 48)


def test_scenes_are_deterministic_in_the_seed():
    assert crowded(6).to_json() == crowded(6).to_json() != crowded(6, seed=1).to_json()
    for count in COUNTS:
        scene = crowded(count)
        assert len(scene.objects) == count + 1
        assert scene.objects[0].environment


def test_larger_populations_begin_with_smaller_ones(three):
    scene, layouts = three
    subset = noisy_layouts(scene, 5)
    assert np.array_equal(subset.xy, layouts.xy[:5])
    assert not subset.xy[:, 0].any(), "the table stays"
    bounded = noisy_layouts(scene, 50, noise=Noise(scales=(0.7, 1.4)))
    assert math.log(0.7) <= bounded.log_scale.min() < -0.2
    assert 0.2 < bounded.log_scale.max() <= math.log(1.4)


def test_forty_to_eighty_percent_of_noisy_layouts_fail(three):
    for scene, layouts in (three, _drawn(10)):
        stable = np.mean(motion(scene, NativeEngine().rollout(scene, scene.place(layouts))) < 1)
        assert 0.2 <= stable <= 0.6


def test_a_crowded_scene_without_overlaps_is_stable():
    scene, _ = _drawn(10)
    still = scene.place(noisy_layouts(scene, 1, noise=Noise(0, 0, 0)))
    assert motion(scene, NativeEngine().rollout(scene, still)) < 0.1


def _drawn(count):
    scene = compile_scene(crowded(count))
    return scene, noisy_layouts(scene, 48)


def test_naive_loop_matches_native_engine_and_respects_budget(three):
    scene, layouts = three
    poses = scene.place_exactly(layouts)
    loop = naive_loop(scene, layouts[:12], poses_of(poses, 12))
    ours = motion(scene, NativeEngine().rollout(scene, poses[:12]))
    assert loop.steps == 250
    assert np.median(np.abs(loop.motion - ours)) < 1e-3
    # One layout of these is decided by rounding: nudged by 1e-13 the loop itself says either.
    assert compare(loop.motion, ours).share(near=False) >= 0.8
    assert loop.candidates_per_s < loop.steps_per_s / 250
    assert len(naive_loop(scene, layouts, poses, budget=0.0).motion) == 1


def poses_of(poses, count):
    return type(poses)(
        *(leaf[:count] for leaf in (poses.pos, poses.quat, poses.scale, poses.height))
    )


def test_borderline_verdicts_are_determined_by_the_reference():
    reported = compare(np.array([0.1, 0.6, 1.9, 5.0]), np.array([0.1, 1.2, 1.8, 0.9]))
    assert reported.near.tolist() == [False, True, True, False]
    assert reported.same.tolist() == [True, False, True, False]
    assert (reported.share(near=False), reported.share(near=True)) == (0.5, 0.5)


def test_motion_of_a_failed_candidate_is_infinite(three):
    scene, _ = three
    broken = noisy_layouts(scene, 2)
    broken.xy[1, 1] = np.nan
    rollout = NativeEngine().rollout(scene, scene.place(broken), duration=0.1)
    assert motion(scene, rollout)[1] == np.inf
    assert rollout.status[1] == RolloutStatus.FAILED


@pytest.mark.parametrize("name", ["stack", "container"])
def test_engines_agree_with_recompiled_scenes(name):
    engines = ("native",) if name == "container" else ("native", "warp")
    rows = list(agreement([name], engines, layouts=16))
    models = [row for row in rows if isinstance(row, ModelRow)]
    assert len(models) == 1 and models[0].passed, models
    assert models[0].bit_equal_share == 1 and not models[0].loose_fields
    assert models[0].field_error < 1e-9
    verdicts = [row for row in rows if isinstance(row, VerdictRow) and row.engine == "native"]
    assert [row.early_stop for row in verdicts] == [False, True]
    assert all(row.passed for row in verdicts), verdicts
    assert agreed(rows)["passed"]
    for row in rows:
        if isinstance(row, VerdictRow) and row.engine == "warp":
            assert row.passed is not None or row.note


@pytest.mark.slow
def test_all_six_scenes_agree():
    rows = list(agreement(engines=("native", "mjx")))
    assert agreed(rows)["passed"], agreed(rows)
    for row in rows:
        if isinstance(row, ModelRow):
            assert 0.3 <= row.stable_share <= 0.7, row.scene
    assert len({row.scene for row in rows}) == len(AGREEMENT) == 6


def test_agreement_detects_wrong_inertia_scaling(monkeypatch):
    from neoworld_bench.engines import agreement as comparing

    from neoworld_mjx.physics import native

    right = native.model_fields

    def wrong(scene, poses, xp):
        fields = right(scene, poses, xp)
        return {**fields, "body_inertia": fields["body_inertia"] * 1.000001}

    monkeypatch.setattr(native, "model_fields", wrong)
    row = next(iter(comparing.agreement(["stack"], (), layouts=2)))
    assert isinstance(row, ModelRow) and not row.passed
    assert "body_inertia" in row.loose_fields


def test_physics_rows_compare_rates_with_the_naive_loop():
    rows = list(physics((3,), (64,), ("native", "warp"), duration=0.5, budget=20, apart=False))
    assert [(row.engine, row.early_stop) for row in rows] == [
        *[("native", False), ("native", True)],
        *[("warp", False), ("warp", True)],
    ]
    full, early = rows[:2]
    for row in (full, early):
        assert row.status == "ok" and row.repeats >= 1
        assert row.steps == 125 and row.population == 64
        assert row.candidates_per_s == pytest.approx(64 / row.steady_s)
        assert row.naive_candidates_per_s > 0 and row.bare_scan_candidates_per_s is None
        assert row.verdict_agreement_clear >= 0.95 and row.compared == 64
        assert 0 < row.stable_share < 1 and row.peak_mib > 50
    assert full.mean_steps == 125 > early.mean_steps
    for row in rows[2:]:
        assert row.status.startswith(("ok", "skipped"))


@pytest.mark.slow
def test_row_runs_in_a_separate_process_within_its_budget(monkeypatch):
    task = Task(engine="native", objects=3, population=8, duration_s=0.1, budget_s=20)
    result = timing._in_a_process(task)
    assert result.steady_s and len(result.motion) == 8
    monkeypatch.setattr(timing, "_START_S", 0.05)
    late = timing._in_a_process(task.model_copy(update={"budget_s": 0.05}))
    assert late == "skipped: budget"


def test_unavailable_engine_is_skipped_with_its_reason(monkeypatch):
    def refuses(name):
        raise EngineError("no such device")

    monkeypatch.setattr(timing, "open_engine", refuses)
    task = Task(engine="warp", objects=3, population=4)
    assert measure(task) == "skipped: no such device"


def test_engine_with_wrong_verdicts_has_no_rate(monkeypatch):
    class Frozen:
        def rollout(self, scene, poses, **options):
            real = NativeEngine().rollout(scene, poses, duration=options["duration"])
            pos, quat = (
                jnp.broadcast_to(start[:, None], moved.shape)
                for start, moved in ((real.start.pos, real.pos), (real.start.quat, real.quat))
            )
            return eqx.tree_at(lambda r: (r.pos, r.quat), real, (pos, quat))

    monkeypatch.setattr(timing, "open_engine", lambda name: Frozen())
    row = next(physics((3,), (24,), ("native",), early_stop=(False,), apart=False))
    assert row.status.startswith("invalid") and row.candidates_per_s is None


def test_growth_recovers_a_power_law(tmp_path):
    def row(objects, rate):
        about = {"engine": "native", "population": 8, "steps": 250, "early_stop": False}
        return PhysicsRow(
            objects=objects, candidates_per_s=rate, naive_candidates_per_s=rate / 4, **about
        )

    result = growth([row(n, 1e4 * n**-1.5) for n in COUNTS])
    assert [g.label for g in result] == ["naive loop", "native"]
    assert all(g.exponent == pytest.approx(1.5) for g in result)
    for curves in (result, []):
        write_chart(tmp_path / "growth.svg", curves)
        text = (tmp_path / "growth.svg").read_text()
        assert ET.fromstring(text) is not None
        assert ("native ~ objects^1.50" in text) == bool(curves)


def test_kernel_rows_have_times_and_errors_against_the_reference():
    rows = list(kernels((3,), (16,), samples=32, budget=0.5))
    assert [row.implementation for row in rows] == ["jnp", "culled", "pallas", "auto"]
    assert rows[0].max_error_m == 0
    for row in rows:
        assert row.status != "ok" or (row.ms > 0 and row.max_error_m <= 1e-5)
    assert {row.implementation for row in rows if row.status == "ok"} >= {"jnp", "culled", "auto"}


def test_sampled_depths_agree_with_mujoco():
    rows = accuracy(random_pairs(4_000, each=4))
    total = rows[0]
    assert total.pairs == 4_000 and len(rows) == 1 + len(KINDS) * (len(KINDS) + 1) // 2
    assert total.touching > 1600 and total.deep > 1000
    assert total.missed_deep <= 0.02
    assert total.spearman >= 0.95
    assert total.false == 0, "nothing that MuJoCo calls apart"
    for row in rows:
        assert row.deep > 10 and row.missed_deep <= 0.02, row
        assert row.spearman >= 0.9, row


def test_dispatch_starts_at_the_size_from_which_the_kernel_stays_faster():
    def rows(population, jnp_ms, pallas_ms):
        sizes = {"objects": 4, "population": population, "samples": 10, "pieces": 5}
        return [
            KernelRow(implementation="jnp", ms=jnp_ms, **sizes),
            KernelRow(implementation="pallas", ms=pallas_ms, **sizes),
        ]

    some = [*rows(8, 1.0, 0.9), *rows(16, 1.0, 1.1), *rows(32, 2.0, 1.5), *rows(64, 4.0, 2.0)]
    assert dispatch(some)["pallas_from"] == 32 * 4 * 10 * 5
    assert dispatch([*some, *rows(128, 5.0, 6.0)])["pallas_from"] is None
    with pytest.raises(EngineError, match="both jnp and pallas"):
        dispatch(some[:1])


def _exit_code(*words):
    with pytest.raises(SystemExit) as ended:
        cli.main(["bench", *words])
    return ended.value.code


def test_physics_command_prints_rows_and_draws_chart(capfd, tmp_path, monkeypatch):
    monkeypatch.setattr(timing, "_in_a_process", measure)
    chart, rows = tmp_path / "growth.svg", tmp_path / "rows.json"
    options = ["--objects", "3", "--population", "8", "--engine", "native", "--duration", "0.1"]
    options += ["--chart", str(chart), "--json"]
    assert _exit_code("run", "physics", *options) == 0
    text = capfd.readouterr().out
    answer = json.loads(text)
    expected = {"engine", "objects", "population", "steps", "early_stop", "candidates_per_s"}
    expected |= {"naive_candidates_per_s", "bare_scan_candidates_per_s", "compile_s", "peak_mib"}
    expected |= {"verdict_agreement", "stable_share"}
    assert len(answer["rows"]) == 2 and all(expected <= set(row) for row in answer["rows"])
    assert answer["machine"]["versions"]["mujoco"] == mujoco.__version__
    rows.write_text(text)
    assert _exit_code("chart", str(rows), "--out", str(tmp_path / "again.svg")) == 0
    assert (tmp_path / "again.svg").read_bytes() == chart.read_bytes()


def test_chart_of_a_file_without_rows_names_the_file(tmp_path, capsys):
    (tmp_path / "x.json").write_text("{}")
    assert _exit_code("chart", str(tmp_path / "x.json"), "--out", str(tmp_path / "x.svg")) == 2
    assert "x.json is not what bench run physics --json prints" in capsys.readouterr().err

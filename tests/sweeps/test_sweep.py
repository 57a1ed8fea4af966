"""Sweeps and ablations of a small scene: rows, resuming, shards and commands."""

import json

import arro3.io
import numpy as np
import pytest
import yaml
from neoworld_bench.engines.table_scenes import Noise, noisy_layouts

import neoworld_mjx as nw
from neoworld_mjx.errors import ConfigError, RunError
from neoworld_mjx.machines import Machines
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.sweeps import Case, Plan, ablate, merge, run, sweep
from neoworld_mjx.sweeps.folder import SweepFolder, read_rows
from neoworld_mjx.sweeps.plan import points, read_plan
from neoworld_mjx.sweeps.runs import COLUMNS
from tests.support.scenes import stored_scene

SCENE = Case("two", stored_scene("crowded_2"))
BASE = {
    "refine": {
        "cem": {"population": 8, "iterations": 2, "elite_ratio": 0.25, "hold_resting": False},
        "settle": {"enabled": False},
        "rollout": {
            "engine": "native",
            "duration_s": 0.2,
            "record_every_s": 0.05,
            "samples_per_object": 32,
        },
        "check_duration_s": 0.2,
        "finalists": 2,
    }
}
DRIFT, SIGMA = "refine.reward.w_drift", "refine.cem.sigma_yaw_deg"
AXES = {DRIFT: [1, 2], SIGMA: [5, 10]}


def plan(seeds=(0, 1), **more):
    return {"base": BASE, "seeds": list(seeds), "axes": AXES} | more


def without_times(rows):
    return [{k: v for k, v in row.items() if k not in ("seconds", "to_valid_s")} for row in rows]


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    out = tmp_path_factory.mktemp("sweep") / "new"
    return out, sweep(plan(), out, cases=[SCENE])


@pytest.fixture
def computed(monkeypatch):
    """Keys of the runs that are computed from now on; the run of a key in `stop_at` fails."""
    keys, stop_at = [], set()
    compute = run.compute

    def counting(task):
        keys.append((task.point.label, task.seed))
        if len(keys) in stop_at:
            raise KeyboardInterrupt
        yield from compute(task)

    monkeypatch.setattr(run, "compute", counting)
    return keys, stop_at


def test_a_row_is_a_run(swept):
    out, result = swept
    rows = read_rows(out)
    assert [(row[DRIFT], row[SIGMA], row["seed"]) for row in rows] == [
        (w, s, k) for w in (1.0, 2.0) for s in (5.0, 10.0) for k in (0, 1)
    ]
    columns = arro3.io.read_parquet(out / "results.parquet").schema.names
    assert list(columns) == ["scene", "point", "seed", DRIFT, SIGMA, *COLUMNS]
    assert len({row["fingerprint"] for row in rows}) == 8
    assert rows == result.rows
    for row in rows:
        assert (row["rollouts"], row["xy_error_m"]) == (16, None)
        assert np.isfinite([row[n] for n in ("reward", "d_pen_m", "d_drift", "seconds")]).all()


def test_a_row_describes_one_refinement(swept):
    _, result = swept
    settings = {point.label: point for point in points(read_plan(plan(), Plan))}
    for row in result.rows[::3]:  # Both seeds, three of the four points.
        options = settings[row["point"]].options
        one = nw.refine(SCENE.scene, options, seed=row["seed"], engine=NativeEngine())
        for column, name in {"reward": "reward", "d_pen_m": "d_pen", "s_sem": "s_sem"}.items():
            assert row[column] == one.history[name][one.winner] == one.scores[name]
        assert (row["passed"], row["mean_log_scale"]) == (one.passed, one.mean_log_scale)
        valid = np.flatnonzero(one.history["valid"].any(axis=1))
        first = None if not len(valid) else int(valid[0]) + 1
        assert row["iterations_to_valid"] == first
        assert row["rollouts_to_valid"] == (first and 8 * first)
        best = np.maximum.accumulate(one.history["reward"].max(axis=1))
        assert [step["best"] for step in row["history"]] == pytest.approx(best)
        assert [step["rollouts"] for step in row["history"]] == [8, 16]


def test_a_case_may_have_a_start_and_errors():
    start = lambda model, seed: noisy_layouts(model, 1, seed=seed, noise=Noise(0.05, 0.1, 0.1))
    noisy = Case("noisy", SCENE.scene, start, lambda scene: {"xy_m": 0.25})
    first, second = sweep(plan(axes={}), cases=[noisy]).rows
    assert first["xy_error_m"] == 0.25 and first["point"] == "base"
    assert first["history"][0]["d_drift"] != second["history"][0]["d_drift"]


def test_the_table_sums_points_up(swept):
    out, result = swept
    assert (out / "figure.svg").stat().st_size > 0
    assert (out / "table.md").read_text().count("\n| reward.w_drift ") == 4
    point = result.points[0]
    own = [row for row in result.rows if row["point"] == point["point"]]
    assert point["n"] == 2
    assert point["reward"]["mean"] == pytest.approx(np.mean([row["reward"] for row in own]))
    assert 0 <= point["passed"]["low"] <= point["passed"]["mean"] <= point["passed"]["high"] <= 1
    about = json.loads((out / "sweep.json").read_text())
    assert (about["finished"], about["missing"]) == (True, 0)


def test_an_existing_sweep_is_not_replaced_by_accident(swept, tmp_path):
    out, _ = swept
    before = (out / "rows.jsonl").read_bytes()
    with pytest.raises(RunError, match="holds a sweep: continue with --resume, start over"):
        sweep(plan(), out, cases=[SCENE])
    with pytest.raises(RunError, match=r"has 4 rows that this plan does not contain.*--overwrite"):
        sweep(plan(axes=AXES | {DRIFT: [1]}), out, cases=[SCENE], resume=True)
    with pytest.raises(RunError, match="holds another kind of run, sweep"):
        variants = {"free": {DRIFT: 0}}
        ablate({"base": BASE, "variants": variants}, out, cases=[SCENE], overwrite=True)
    with (
        SweepFolder(out, "sweep", resume=True, overwrite=False),
        pytest.raises(RunError, match=r"is in use by another run \(process \d+\)"),
    ):
        sweep(plan(), out, cases=[SCENE], resume=True)
    assert (out / "rows.jsonl").read_bytes() == before
    assert json.loads((out / "sweep.json").read_text())["finished"]
    (tmp_path / "mine.txt").write_text("")
    for more in ({}, {"overwrite": True}, {"resume": True}):
        with pytest.raises(RunError, match="not empty and holds no sweep"):
            sweep(plan(), tmp_path, cases=[SCENE], **more)


def test_an_interrupted_sweep_resumes(swept, computed, tmp_path):
    _, whole = swept
    keys, stop_at = computed
    stop_at.add(3)
    half = plan(axes=AXES | {SIGMA: [5]})
    with pytest.raises(KeyboardInterrupt):
        sweep(half, tmp_path, cases=[SCENE])
    assert len(read_rows(tmp_path)) == 2
    assert not json.loads((tmp_path / "sweep.json").read_text())["finished"]
    result = sweep(half, tmp_path, cases=[SCENE], resume=True)
    assert len(keys) == 3 + 2
    expected = [row["reward"] for row in whole.rows if row[SIGMA] == 5]
    assert [row["reward"] for row in result.rows] == expected


def test_shards_are_merged_to_the_whole_sweep(swept, tmp_path):
    _, whole = swept
    shards = [tmp_path / str(k) for k in (1, 2, 3)]
    for k, shard in enumerate(shards, start=1):
        sweep(plan(), shard, cases=[SCENE], shard=(k, 3))
    result = merge(shards, tmp_path / "all")
    assert result.about["finished"] and result.about["missing"] == 0
    rows, expected = without_times(result.rows), without_times(whole.rows)
    assert rows == [{name: row.get(name) for name in rows[0]} for row in expected]
    again = sweep(plan(), tmp_path / "all", cases=[SCENE], resume=True)
    assert without_times(again.rows) == rows
    part = merge(shards[:2], tmp_path / "part")
    assert not part.about["finished"] and part.about["missing"] == 2
    other = tmp_path / "other"
    sweep(plan(axes=AXES | {SIGMA: [5, 11]}), other, cases=[SCENE], shard=(1, 8))
    for folders, message in (
        ([], "name the folders"),
        ([shards[0], shards[0]], "appears twice"),
        ([shards[0], tmp_path], "holds no sweep or ablation"),
        ([shards[0], other], "differ in plan: axes: .*sigma_yaw_deg: .*10.*11"),
    ):
        with pytest.raises(RunError, match=message):
            merge(folders, tmp_path / "refused")
    for shard in ((0, 2), (3, 2), (9, 9)):
        with pytest.raises(ConfigError, match="shard: "):
            sweep(plan(), cases=[SCENE], shard=shard)


def test_an_ablation_reports_differences(tmp_path):
    variants = {"steadier": {DRIFT: 5}, "wider": {SIGMA: 60}}
    requests = {"base": BASE, "seeds": [0, 1], "variants": variants}
    result = ablate(requests, tmp_path / "a", cases=[SCENE])
    rows = read_rows(tmp_path / "a")
    assert [row["variant"] for row in rows[::2]] == ["base", "steadier", "wider"]
    steadier, wider = result.differences
    assert (steadier["point"], steadier["n"]) == ("steadier", 2)
    for first, difference in ((2, steadier), (4, wider)):
        changes = [rows[first + k]["reward"] - rows[k]["reward"] for k in (0, 1)]
        assert difference["reward"]["mean"] == pytest.approx(np.mean(changes)) != 0
    assert "## Differences from the base" in (tmp_path / "a" / "table.md").read_text()


@pytest.mark.slow
def test_processes_give_the_rows_of_one(swept):
    _, whole = swept
    result = sweep(plan(), cases=[SCENE], machines=Machines(workers=2))
    assert without_times(result.rows) == without_times(whole.rows)


@pytest.mark.parametrize(
    ("requests", "cases", "message"),
    [
        (plan(), [], "scenes: name at least one"),
        (plan(), [SCENE, SCENE], "two appears twice"),
        (plan(axes={"refine.semantic.scorer": ["mllm"]}), [SCENE], "score S_sem by geometry"),
    ],
)
def test_what_cannot_run_is_refused(requests, cases, message):
    with pytest.raises(ConfigError, match=message):
        sweep(requests, cases=cases)


def test_the_commands(tmp_path, capfd):
    from neoworld_mjx.cli import run as command
    from neoworld_mjx.commands.sweep_commands import AblateCommand, SweepCommand

    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(plan([0], axes={DRIFT: [1]}, scenes=["crowded:2"])))
    assert command(SweepCommand(plan=path, out=tmp_path / "out", json=True)) == 0
    reported = json.loads(capfd.readouterr().out)
    assert (reported["runs"], reported["points"][0]["n"]) == (1, 1)
    assert reported["points"][0]["reward_low"] is None  # one run has no interval
    assert command(SweepCommand(plan=path, out=tmp_path / "out", json=True)) == 2
    assert "--resume" in json.loads(capfd.readouterr().out)["error"]
    assert command(AblateCommand(plan=path, out=tmp_path / "b", json=True)) == 2
    assert "unknown key axes" in json.loads(capfd.readouterr().out)["error"]
    assert not (tmp_path / "b").exists()

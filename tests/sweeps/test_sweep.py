import json

import jax
import numpy as np
import pytest
import yaml

import neoworld_mjx
from neoworld_mjx.errors import ConfigError, NeoWorldError, RunError
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.sweeps import Case, ablate, group_runs, run, sweep
from neoworld_mjx.sweeps.run_rows import COLUMNS, read_runs
from tests.support.notebooks import run_small
from tests.support.scenes import stored_scene

SCENE = Case("two", stored_scene("crowded_2"))
BASE = {
    "refine": {
        "cem": {"population": 8, "iterations": 2, "elite_ratio": 0.25, "hold_resting": False},
        "settle": {"enabled": False},
        "rollout": {"engine": "native", "duration_s": 0.2, "samples_per_object": 64},
        "check_duration_s": 0.2,
        "finalists": 2,
    }
}
DRIFT, SIGMA = "refine.reward.w_drift", "refine.cem.sigma_yaw_deg"


def plan(seeds=(0, 1), **axes):
    named = {"drift": DRIFT, "sigma": SIGMA, "static": "refine.rollout.duration_s"}
    return {
        "base": BASE,
        "seeds": list(seeds),
        "axes": {named[name]: values for name, values in axes.items()},
    }


@pytest.fixture(scope="module", autouse=True)
def _compiled_once():
    """Most of the time of a small sweep is compiling its scene, which these tests share."""
    remaining, built = run.compile_for_search, {}

    def compiled(scene, o):
        key = (scene.model_dump_json(), o.cem.sigma_xy, o.rollout.timestep_s)
        if key not in built:
            built[key] = remaining(scene, o)
        return built[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "compile_for_search", compiled)
        yield


def without_times(rows):
    return [{k: v for k, v in row.items() if not k.endswith("_s") and k != "seconds"}
            for row in rows]  # fmt: skip


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    jax.clear_caches()  # Padded scenes share programs, which other tests may have compiled.
    out = tmp_path_factory.mktemp("sweep") / "new"
    return out, sweep(plan(drift=[1, 2], sigma=[5, 10]), out, cases=[SCENE])


def test_the_public_name_is_a_function():
    assert neoworld_mjx.sweep is sweep


def test_a_row_is_a_run(swept):
    out, result = swept
    rows = read_runs(out / "results.parquet")
    assert [(row[DRIFT], row[SIGMA], row["seed"]) for row in rows] == [
        (w, s, k) for w in (1.0, 2.0) for s in (5.0, 10.0) for k in (0, 1)
    ]
    assert list(rows[0]) == ["scene", "point", "seed", DRIFT, SIGMA, *COLUMNS]
    assert len({row["fingerprint"] for row in rows}) == 8
    for row, own in zip(rows, result.rows, strict=True):
        assert {name: own.get(name) for name in row} == row
        assert row["rollouts"] == 16
        assert row["xy_error_m"] is None
        assert np.isfinite(
            [row[n] for n in ("reward", "d_pen_m", "d_drift", "s_sem", "seconds")]
        ).all()


def test_the_table_sums_points_up(swept):
    out, result = swept
    text = (out / "table.md").read_text()
    assert text.count("\n| reward.w_drift ") == 4
    point = result.points[0]
    own = [row for row in result.rows if row["point"] == point["point"]]
    assert point["n"] == 2
    assert point["reward"]["mean"] == pytest.approx(np.mean([row["reward"] for row in own]))
    assert 0 <= point["passed"]["low"] <= point["passed"]["mean"] <= point["passed"]["high"] <= 1
    about = json.loads((out / "sweep.json").read_text())
    assert about["finished"]
    assert about["static"] == []
    assert [group["runs"] for group in about["groups"]] == [8]
    assert about["compilations"] > 0


def test_the_notebook_runs_in_small_form():
    base = """{
        "refine": {
            "cem": {"population": 24, "iterations": 4, "hold_resting": False, "stop_by": "elites"},
            "settle": {"enabled": False},
            "rollout": {"engine": "native"},
        }
    }"""
    changes = {
        '"seeds": [0, 1, 2]': '"seeds": [0, 1]',
        f'"base": {base}': '"base": BASE',
        "wide: [0.01, 0.03, 0.08]": "wide: [0.01, 0.08]",
        "cases=[scene]": "cases=[SCENE]",
        "== 18": "== 8",
        "passed.max() == 1.0": "passed.shape == (2, 2)",
    }
    ran = run_small("sweep_with_plots", changes, BASE=BASE, SCENE=SCENE)
    assert {row["seed"] for row in ran["found"].rows} == {0, 1}


def test_an_existing_sweep_is_not_replaced_by_accident(swept, tmp_path):
    out, _ = swept
    before = (out / "results.parquet").read_bytes()
    with pytest.raises(RunError, match="holds a sweep: continue with --resume, start over"):
        sweep(plan(drift=[1]), out, cases=[SCENE])
    with pytest.raises(RunError, match=r"has 4 rows that this plan does not contain.*--overwrite"):
        sweep(plan(drift=[1], sigma=[5, 10]), out, cases=[SCENE], resume=True)
    with pytest.raises(RunError, match="holds another kind of run, sweep"):
        variants = {"free": {DRIFT: 0}}
        ablate({"base": BASE, "variants": variants}, out, cases=[SCENE], overwrite=True)
    assert (out / "results.parquet").read_bytes() == before
    assert json.loads((out / "sweep.json").read_text())["finished"]
    (tmp_path / "mine.txt").write_text("")
    for more in ({}, {"overwrite": True}, {"resume": True}):
        with pytest.raises(RunError, match="not empty and holds no sweep"):
            sweep(plan(drift=[1]), tmp_path, cases=[SCENE], **more)


class Failing(NativeEngine):
    """An engine that stops the sweep."""

    def rollout(self, *args, duration, **more):
        if duration > 0.25:
            raise KeyboardInterrupt
        return super().rollout(*args, duration=duration, **more)


def test_an_interrupted_sweep_resumes(tmp_path, monkeypatch):
    requests = plan(seeds=[0], static=[0.2, 0.3])
    with pytest.raises(KeyboardInterrupt):
        sweep(requests, tmp_path, cases=[SCENE], engine=Failing())
    (row,) = read_runs(tmp_path / "results.parquet")
    assert row["refine.rollout.duration_s"] == 0.2
    about = json.loads((tmp_path / "sweep.json").read_text())
    assert (about["finished"], len(about["groups"])) == (False, 1)
    completed = []
    remaining = group_runs.search
    monkeypatch.setattr(
        group_runs,
        "search",
        lambda m, r, e, **o: completed.append(len(r)) or remaining(m, r, e, **o),
    )
    result = sweep(requests, tmp_path, cases=[SCENE], engine=NativeEngine(), resume=True)
    assert completed == [1]
    assert len(result.about["groups"]) == 2
    assert result.about["static"][0].startswith("refine.rollout.duration_s = 0.2, 0.3 (is shared")
    assert result.rows[0]["history"]
    assert (
        without_times(result.rows)[0]
        == without_times([row | {"history": result.rows[0]["history"]}])[0]
    )
    # Other options are other runs, whatever their labels.
    other = requests | {"base": {"refine": BASE["refine"] | {"finalists": 3}}}
    sweep(other, tmp_path, cases=[SCENE], engine=NativeEngine(), resume=True)
    assert completed == [1, 1, 1]


def test_an_ablation_reports_differences(tmp_path):
    variants = {"not held": {"refine.cem.hold_resting": True}, "elsewhere": {SIGMA: 60}}
    requests = {"base": BASE, "seeds": [0, 1], "variants": variants}
    result = ablate(requests, tmp_path / "a", cases=[SCENE])
    rows = read_runs(tmp_path / "a" / "results.parquet")
    assert [row["variant"] for row in rows[::2]] == ["base", "not held", "elsewhere"]
    same, other = result.differences
    assert (same["point"], same["n"]) == ("not held", 2)
    assert same["reward"]["mean"] == 0
    assert other["reward"]["mean"] == pytest.approx(
        np.mean([rows[4 + k]["reward"] - rows[k]["reward"] for k in (0, 1)])
    )
    assert other["reward"]["mean"] != 0
    assert "## Differences from the base" in (tmp_path / "a" / "table.md").read_text()
    # As one computation it comes to the same.
    folded = ablate(requests | {"fold": True}, cases=[SCENE])
    for a, b in zip(folded.rows, rows, strict=True):
        assert a["iterations"] == b["iterations"]
        assert (a["reward"], a["mean_log_scale"]) == (b["reward"], b["mean_log_scale"])


def test_scenes_must_be_there_and_different():
    with pytest.raises(ConfigError, match="scenes: name at least one"):
        sweep(plan(drift=[1]))
    with pytest.raises(ConfigError, match="two appears twice"):
        sweep(plan(drift=[1]), cases=[SCENE, SCENE])


def test_the_commands(tmp_path, capfd):
    from neoworld_mjx.cli import run as command
    from neoworld_mjx.commands.sweep_commands import AblateCommand, SweepCommand

    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(plan(seeds=[0], drift=[1]) | {"scenes": ["crowded:2"]}))
    assert command(SweepCommand(plan=path, out=tmp_path / "out", json=True)) == 0
    reported = json.loads(capfd.readouterr().out)
    assert (reported["runs"], reported["points"][0]["n"]) == (1, 1)
    assert reported["points"][0]["reward_low"] is None  # one run has no interval
    assert command(SweepCommand(plan=path, out=tmp_path / "out", json=True)) == 2
    assert "--resume" in json.loads(capfd.readouterr().out)["error"]
    assert command(AblateCommand(plan=path, out=tmp_path / "b", json=True)) == 2
    assert "unknown key axes" in json.loads(capfd.readouterr().out)["error"]
    assert not (tmp_path / "b").exists()


def test_a_damaged_results_file_is_reported(tmp_path):
    (tmp_path / "sweep.json").write_text('{"format": "neoworld-sweep/1", "kind": "sweep"}')
    (tmp_path / "results.parquet").write_bytes(b"half")
    with pytest.raises(NeoWorldError, match="is not a Parquet file"):
        sweep(plan(drift=[1]), tmp_path, cases=[SCENE], resume=True)

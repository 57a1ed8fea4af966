import json

import jax
import numpy as np
import pytest
import yaml

import neoworld_mjx
from neoworld_mjx.errors import ConfigError, NeoWorldError, RunError
from neoworld_mjx.physics.engine import zero_duration_rollout
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement import refine
from neoworld_mjx.refinement.compiling import compile_for_search
from neoworld_mjx.refinement.rewards import s_sem
from neoworld_mjx.sweeps import Case, Plan, ablate, group_runs, merge, sweep
from neoworld_mjx.sweeps.folder import SweepFolder
from neoworld_mjx.sweeps.plan import points, read_plan
from neoworld_mjx.sweeps.run import check
from neoworld_mjx.sweeps.run_rows import COLUMNS, read_runs
from tests.support.notebooks import run_small
from tests.support.scenes import stored_scene

pytestmark = pytest.mark.usefixtures("without_figures", "compiled_once")
SCENE = Case("two", stored_scene("crowded_2"))
# Padded scenes share programs: no other test records so often and compiles what scores this one.
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


def plan(seeds=(0, 1), **axes):
    named = {"drift": DRIFT, "sigma": SIGMA, "static": "refine.rollout.duration_s"}
    return {
        "base": BASE,
        "seeds": list(seeds),
        "axes": {named[name]: values for name, values in axes.items()},
    }


def without_times(rows):
    return [{k: v for k, v in row.items() if not k.endswith("_s") and k != "seconds"}
            for row in rows]  # fmt: skip


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
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
    assert (out / "figure.svg").stat().st_size > 0 and (out / "figure.pdf").stat().st_size > 0
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


def searched_runs(monkeypatch):
    """Return a list that receives the number of runs of every search from now on."""
    counts = []
    remaining = group_runs.search
    count = lambda m, r, e, **o: counts.append(len(r)) or remaining(m, r, e, **o)
    monkeypatch.setattr(group_runs, "search", count)
    return counts


def test_a_row_describes_what_was_delivered(swept):
    """The winner is settled once more by the final check, so its values are not the candidate's."""
    _, result = swept
    for row in result.rows[::3]:  # Both seeds, three of the four points.
        o = points(read_plan(plan(drift=[1, 2], sigma=[5, 10]), Plan))
        (options,) = (point.options for point in o if point.label == row["point"])
        one = refine(SCENE.scene, options, seed=row["seed"], engine=NativeEngine())
        assert row["candidate_reward"] == one.history["absolute"][one.winner]
        assert row["candidate_merit"] == one.history["merit"][one.winner]
        assert row["candidate_d_pen_m"] == one.history["d_pen"][one.winner]
        for column, name in {"reward": "absolute", "merit": "merit", "s_sem": "s_sem"}.items():
            assert row[column] == one.delivered[name]
        model = compile_for_search(SCENE.scene, options)
        poses = model.place(Layout(*(np.asarray(x) for x in jax.tree.leaves(one.layout))))
        assert row["s_sem"] == pytest.approx(
            float(s_sem(model, one.layout, zero_duration_rollout(model, poses))[0]), abs=1e-3
        )
        assert row["rollouts_to_valid"] in (None, 8, 16)
        assert (row["iterations_to_valid"] is None) == (row["rollouts_to_valid"] is None)
        best = [step["best"] for step in row["history"]]
        assert row["candidate_reward"] <= max(best) + 1e-6
        assert [step["rollouts"] for step in row["history"]] == [8, 16]


def test_two_sweeps_in_one_folder_are_refused(swept):
    out, _ = swept
    with (
        SweepFolder(out, "sweep", resume=True, overwrite=False),
        pytest.raises(RunError, match=r"is in use by another run \(process \d+\)"),
    ):
        sweep(plan(drift=[1]), out, cases=[SCENE], resume=True)


class Stopping(NativeEngine):
    """An engine that stops a sweep after a number of rollouts."""

    left = 3

    def rollout(self, *args, **more):
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().rollout(*args, **more)


def test_a_group_that_is_killed_keeps_its_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(group_runs, "CANDIDATES_AT_ONCE", 8)
    monkeypatch.setattr(group_runs.os, "cpu_count", lambda: 4)
    requests = plan(drift=[1, 2])
    with pytest.raises(KeyboardInterrupt):
        sweep(requests, tmp_path, cases=[SCENE], engine=Stopping())
    assert len(read_runs(tmp_path / "results.parquet")) == 1
    counts = searched_runs(monkeypatch)
    result = sweep(requests, tmp_path, cases=[SCENE], engine=NativeEngine(), resume=True)
    assert counts == [1, 1, 1] and len(result.rows) == 4
    whole = sweep(requests, cases=[SCENE], engine=NativeEngine())
    assert without_times(result.rows) == without_times(whole.rows)


def test_rows_of_other_inputs_are_not_compared(swept, tmp_path):
    out, _ = swept
    requests = plan(drift=[1, 2], sigma=[5, 10])
    assert check(requests, out, Plan, cases=[SCENE]) == {"checked": 8, "missing": 0}
    more = plan(seeds=(0, 1, 2), drift=[1, 2], sigma=[5, 10])
    assert check(more, out, Plan, cases=[SCENE]) == {"checked": 8, "missing": 4}
    moved = Case("two", stored_scene("crowded_3"))
    other = requests | {"base": {"refine": BASE["refine"] | {"finalists": 3}}}
    for asked, scene in ((requests, moved), (other, SCENE), (plan(drift=[1]), SCENE)):
        with pytest.raises(RunError, match="8 of 8 rows come from other scenes, options or ver"):
            check(asked, out, Plan, cases=[scene])


def test_an_axis_may_be_added_at_its_default(tmp_path, monkeypatch):
    sweep(plan(drift=[1, 2]), tmp_path, cases=[SCENE])
    counts = searched_runs(monkeypatch)
    result = sweep(plan(drift=[1, 2], sigma=[15, 20]), tmp_path, cases=[SCENE], resume=True)
    assert counts == [4]
    rows = read_runs(tmp_path / "results.parquet")
    assert [row[SIGMA] for row in rows] == [15.0, 15.0, 20.0, 20.0] * 2
    assert len({row["point"] for row in rows}) == len(result.points) == 4


def test_a_wider_deviation_elsewhere_changes_no_row(tmp_path, monkeypatch):
    xy = "refine.cem.sigma_xy"
    narrow = plan(seeds=[0]) | {"axes": {xy: [0.03]}}
    first = sweep(narrow, tmp_path, cases=[SCENE])
    both = plan(seeds=[0]) | {"axes": {xy: [0.03, 0.2]}}
    alone = sweep(both, cases=[SCENE])
    assert without_times(alone.rows)[0] == without_times(first.rows)[0]
    counts = searched_runs(monkeypatch)
    sweep(both, tmp_path, cases=[SCENE], resume=True)
    assert counts == [1]


def test_shards_are_merged_to_the_whole_sweep(swept, tmp_path):
    _, whole = swept
    requests = plan(drift=[1, 2], sigma=[5, 10])
    for k in (1, 2, 3):
        sweep(requests, tmp_path / str(k), cases=[SCENE], shard=(k, 3))
    shards = [tmp_path / str(k) for k in (1, 2, 3)]
    result = merge(shards, tmp_path / "all")
    assert result.about["finished"] and result.about["missing"] == 0
    assert without_times(result.rows) == without_times(whole.rows)
    assert [s["shard"] for s in result.about["shards"]] == [[1, 3], [2, 3], [3, 3]]
    rows = read_runs(tmp_path / "all" / "results.parquet")
    assert [row["fingerprint"] for row in rows] == [row["fingerprint"] for row in whole.rows]
    again = sweep(requests, tmp_path / "all", cases=[SCENE], resume=True)
    assert without_times(again.rows) == without_times(whole.rows)
    part = merge(shards[:2], tmp_path / "part")
    assert not part.about["finished"] and part.about["missing"] == 2
    sweep(plan(drift=[1, 2], sigma=[5, 11]), tmp_path / "other", cases=[SCENE], shard=(1, 8))
    for folders, message in (
        ([], "name the folders"),
        ([shards[0], shards[0]], "appears twice"),
        ([shards[0], tmp_path], "holds no sweep or ablation"),
        ([shards[0], tmp_path / "other"], "differ in plan: axes: .*sigma_yaw_deg: .*10.*11"),
    ):
        with pytest.raises(RunError, match=message):
            merge(folders, tmp_path / "refused")
    for shard in ((0, 2), (3, 2), (9, 9)):
        with pytest.raises(ConfigError, match="shard: "):
            sweep(requests, cases=[SCENE], shard=shard)


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
    text = (tmp_path / "a" / "table.md").read_text()
    assert "## Differences from the base" in text and "2 comparisons with the base" in text
    assert (same["scenes"], same["reward"]["wins"], same["reward"]["sign_p"]) == (1, 0, 1.0)
    assert other["reward"]["holm_p"] <= 1.0 and "commit" in result.about
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

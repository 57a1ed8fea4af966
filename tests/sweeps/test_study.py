"""Adaptive sweeps by Optuna, and what happens without it."""

import json
import math
import sys

import pytest

from neoworld_mjx.errors import ConfigError, EngineError, RunError
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.places import Place
from neoworld_mjx.sweeps import Case, sweep
from neoworld_mjx.sweeps.plan import Plan
from neoworld_mjx.sweeps.run_rows import read_runs
from neoworld_mjx.sweeps.study import _value
from tests.support.scenes import stored_scene

pytestmark = pytest.mark.usefixtures("without_figures", "compiled_once")
SCENES = [Case("two", stored_scene("crowded_2")), Case("three", stored_scene("crowded_3"))]
DRIFT, N = "refine.reward.w_drift", "refine.cem.population"
BASE = {
    "refine": {
        "cem": {"population": 8, "iterations": 1, "hold_resting": False},
        "settle": {"enabled": False},
        "rollout": {"engine": "native", "duration_s": 0.1, "samples_per_object": 32},
        "check_duration_s": 0.1,
        "finalists": 1,
    }
}


def plan(axes=None, **study):
    axes = {DRIFT: {"low": 0.25, "high": 4, "log": True}} if axes is None else axes
    study = {"trials": 3, "goal": "candidate_reward"} | study
    return {"base": BASE, "seeds": 1, "axes": axes, "study": study}


def test_without_optuna_a_study_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(EngineError, match=r"study needs optuna: uv sync .*--extra optuna"):
        sweep(plan(), tmp_path / "out", cases=SCENES)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("study", "axes", "message"),
    [
        ({"goal": "rewrd"}, None, "study.goal: .*did you mean 'reward'"),
        ({"goal": "engine"}, None, "study.goal: "),
        ({"trials": 0}, None, "study.trials: .*greater than or equal to 1"),
        ({"sampler": "tp"}, None, "study.sampler: .*'tpe'"),
        ({}, {}, "study: the trials choose the values of axes"),
        ({}, {"refine.reward.w_drft": [1]}, "did you mean 'w_drift'"),
        ({}, {DRIFT: {"low": -1, "high": 1}}, "greater than or equal to 0, got -1"),
        ({}, {DRIFT: [1, "x"]}, "valid number"),
    ],
)
def test_an_invalid_study_is_one_message_before_anything_runs(study, axes, message, tmp_path):
    with pytest.raises(ConfigError, match=message):
        sweep(plan(axes, **study), tmp_path / "out", cases=SCENES)
    assert not (tmp_path / "out").exists()


def test_a_study_is_not_sharded():
    with pytest.raises(ConfigError, match=r"shard: the trials of a study depend .* --workers"):
        sweep(plan(), cases=SCENES, shard=(1, 2))


def test_a_study_that_a_model_scores_has_one_ledger(monkeypatch):
    pytest.importorskip("optuna", reason="needs the extra optuna")
    scored = plan({"refine.semantic.scorer": ["geometric", "mllm"]})
    with pytest.raises(ConfigError, match="has one ledger: it runs in one process"):
        sweep(scored, cases=SCENES, place=Place(workers=2))


@pytest.mark.parametrize("prune", [False, True])
def test_as_many_trials_as_processes_run_at_a_time(prune, tmp_path, monkeypatch):
    pytest.importorskip("optuna", reason="needs the extra optuna")
    sizes, steps = [], []

    def run_tasks(work, tasks, place):
        """Run tasks here in reverse order, as processes may end them."""
        if place.processes == 2:
            sizes.append(len(tasks))
        for task in reversed(tasks):
            yield from work(task)

    monkeypatch.setattr("neoworld_mjx.sweeps.run.run_tasks", run_tasks)
    requests = plan(trials=3, sampler="random", prune=prune)
    more = {"cases": SCENES, "engine": NativeEngine(), "place": Place(workers=2)}
    result = sweep(requests, tmp_path, on_iteration=lambda *step: steps.append(step), **more)
    # First the names of scenes, of which there are none. Then without pruning both scenes of two
    # trials at once; with it, one scene of each at a time.
    assert sizes[:2] == ([0, 4] if not prune else [0, 2])
    rows = read_runs(tmp_path / "results.parquet")
    assert len(result.points) == 3 and result.about["finished"] and len(steps) == len(rows)
    scenes = [[r["scene"] for r in rows if r["point"] == p["point"]] for p in result.points]
    assert all(each in (["two"], ["two", "three"]) for each in scenes)
    assert prune or sum(map(len, scenes)) == 6 == len(rows)
    assert {run.point for run, _ in steps} == {p["point"] for p in result.points}
    assert all(set(run.values) == {DRIFT} for run, _ in steps)


@pytest.mark.slow
def test_trials_run_in_processes(tmp_path):
    pytest.importorskip("optuna", reason="needs the extra optuna")
    result = sweep(plan(trials=2, sampler="random"), cases=SCENES, place=Place(workers=2))
    alone = sweep(plan(trials=2, sampler="random"), cases=SCENES)
    assert [row["reward"] for row in result.rows] == [row["reward"] for row in alone.rows]


class Stopping(NativeEngine):
    """An engine that stops in the second trial's second scene."""

    left = 3

    def rollout(self, *args, **more):
        if len(args[1].scale) > 1:
            self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().rollout(*args, **more)


def test_a_study_resumes_and_repeats_the_trial_that_was_killed(tmp_path):
    pytest.importorskip("optuna", reason="needs the extra optuna")
    axes = {DRIFT: {"low": 0.25, "high": 4, "log": True}, N: [4, 8]}
    with pytest.raises(KeyboardInterrupt):
        sweep(plan(axes), tmp_path, cases=SCENES, engine=Stopping())
    first = read_runs(tmp_path / "results.parquet")
    assert len(first) == 2 and len({row["point"] for row in first}) == 1
    result = sweep(plan(axes), tmp_path, cases=SCENES, resume=True, engine=NativeEngine())
    rows = read_runs(tmp_path / "results.parquet")
    assert rows[:2] == first and len(rows) == 6 == len(result.rows)
    assert len(result.points) == 3 and result.about["finished"]
    about = json.loads((tmp_path / "sweep.json").read_text())
    means = {p["point"]: p["candidate_reward"]["mean"] for p in _summaries(rows)}
    assert about["best"]["candidate_reward"] == pytest.approx(max(means.values()))
    more = sweep(plan(axes, trials=4), tmp_path, cases=SCENES, resume=True, engine=NativeEngine())
    assert len(more.rows) == 8 and [row["fingerprint"] for row in more.rows[:6]] == [
        row["fingerprint"] for row in rows
    ]
    with pytest.raises(RunError, match=r"holds a study of another plan: only study\.trials"):
        sweep(plan(axes, seed=1), tmp_path, cases=SCENES, resume=True)


def _summaries(rows):
    for point in {row["point"] for row in rows}:
        own = [row["candidate_reward"] for row in rows if row["point"] == point]
        yield {"point": point, "candidate_reward": {"mean": sum(own) / len(own)}}


@pytest.mark.parametrize("missing", [None, math.nan, math.inf])
def test_a_run_without_a_finite_value_counts_as_the_worst_run(missing):
    wanted = Plan.model_validate(plan(goal="max_drift_m", direction="minimize"))
    rows = [{"max_drift_m": value} for value in (0.01, 0.03, missing)]
    assert _value(rows, wanted) == pytest.approx((0.01 + 0.03 + 0.03) / 3)


def test_trials_that_begin_badly_end_after_the_first_scene():
    pytest.importorskip("optuna", reason="needs the extra optuna")
    axes = {"refine.reward.w_sem": {"low": 0.25, "high": 4, "log": True}}  # scales the reward
    wanted = plan(axes, sampler="random", trials=6, prune=True)
    result = sweep(wanted, cases=SCENES, engine=NativeEngine())
    scenes = {p["point"]: [] for p in result.points}
    for row in result.rows:
        scenes[row["point"]].append(row["scene"])
    assert len(scenes) == 6 and ["two"] in scenes.values()
    assert all(each in (["two"], ["two", "three"]) for each in scenes.values())
    assert scenes[result.about["best"]["point"]] == ["two", "three"]

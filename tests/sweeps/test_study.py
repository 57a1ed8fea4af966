"""Adaptive sweeps by Optuna, and what happens without it."""

import json
import sys

import pytest

from neoworld_mjx.errors import ConfigError, EngineError, RunError
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.sweeps import Case, sweep
from neoworld_mjx.sweeps.run_rows import read_runs
from tests.support.scenes import stored_scene

SCENES = [Case("two", stored_scene("crowded_2")), Case("three", stored_scene("crowded_3"))]
DRIFT, N = "refine.reward.w_drift", "refine.cem.population"
BASE = {
    "refine": {
        "cem": {"population": 8, "iterations": 1, "hold_resting": False},
        "settle": {"enabled": False},
        "rollout": {"engine": "native", "duration_s": 0.1, "samples_per_object": 64},
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
        ({}, {}, "study: the trials choose values of axes"),
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
    with pytest.raises(ConfigError, match="shard: the trials of a study depend"):
        sweep(plan(), cases=SCENES, shard=(1, 2))


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

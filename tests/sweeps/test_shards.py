"""Sweeps as commands that are killed: in shards, and on Ray."""

import signal
import subprocess
import sys
import time

import pytest
import yaml

from neoworld_mjx.sweeps.folder import read_rows
from tests.support.scenes import stored_scene

PLAN = {
    "seeds": 3,
    "base": {
        "refine": {
            "cem": {"population": 16, "iterations": 1, "hold_resting": False},
            "settle": {"enabled": False},
            "rollout": {"engine": "native", "duration_s": 0.1, "samples_per_object": 16},
            "check_duration_s": 0.1,
            "finalists": 1,
        }
    },
    "axes": {
        "refine.cem.sigma_yaw_deg": {"low": 2.0, "high": 30.0, "n": 4},
        "refine.reward.w_drift": {"low": 0.25, "high": 4.0, "log": True, "n": 4},
    },
}


@pytest.fixture
def plan(tmp_path):
    scene, plan = tmp_path / "scene.json", tmp_path / "plan.yaml"
    scene.write_text(stored_scene("crowded_2").to_json())
    plan.write_text(yaml.safe_dump(PLAN | {"scenes": [str(scene)]}))
    return plan


def start(*words):
    line = [sys.executable, "-m", "neoworld_mjx.cli", "sweep", *map(str, words)]
    return subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def command(*words):
    process = start(*words)
    _, said = process.communicate(timeout=900)
    assert process.returncode == 0, said


def kill(process, folder, rows):
    """Kill a command as soon as its folder has a number of rows, and return the number there."""
    while process.poll() is None and len(read_rows(folder)) < rows:
        time.sleep(0.1)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    return len(read_rows(folder))


def without_times(folder):
    return [
        {k: v for k, v in row.items() if k not in ("seconds", "to_valid_s")}
        for row in read_rows(folder)
    ]


@pytest.mark.slow
def test_shards_of_which_one_was_killed_equal_one_sweep(plan, tmp_path):
    command(plan, "--out", tmp_path / "whole")
    shards = [tmp_path / "first", tmp_path / "second"]
    command(plan, "--out", shards[0], "--shard", "1/2")
    killed = start(plan, "--out", shards[1], "--shard", "2/2")
    assert 0 < kill(killed, shards[1], 1) < 24
    command(plan, "--out", shards[1], "--shard", "2/2", "--resume")
    command("merge", *shards, "--out", tmp_path / "merged")
    whole = without_times(tmp_path / "whole")
    assert len(whole) == 48 and without_times(tmp_path / "merged") == whole
    assert len({row["reward"] for row in whole}) > 12


@pytest.mark.slow
def test_a_sweep_on_ray_that_was_killed_equals_one_sweep(plan, tmp_path):
    pytest.importorskip("ray")
    command(plan, "--out", tmp_path / "whole")
    on_ray = ("--out", tmp_path / "ray", "--ray", "local", "--workers", 2)
    assert 0 < kill(start(plan, *on_ray), tmp_path / "ray", 1) < 48
    command(plan, *on_ray, "--resume")
    assert without_times(tmp_path / "ray") == without_times(tmp_path / "whole")

"""A sweep of 64 points and 8 seeds in four shards, one of them killed, as commands."""

import signal
import subprocess
import sys
import time

import pytest
import yaml

from neoworld_mjx.sweeps.run_rows import read_runs
from tests.support.scenes import stored_scene

PLAN = {
    "seeds": 8,
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
        "refine.cem.sigma_yaw_deg": {"low": 2.0, "high": 30.0, "n": 8},
        "refine.reward.w_drift": {"low": 0.25, "high": 4.0, "log": True, "n": 8},
    },
}


def command(*words, wait=True):
    line = [sys.executable, "-m", "neoworld_mjx.cli", "sweep", *map(str, words)]
    errors = subprocess.PIPE if wait else subprocess.DEVNULL
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=errors, text=True)
    if wait:
        _, said = process.communicate(timeout=900)
        assert process.returncode == 0, said
    return process


def bits(folder):
    return [
        {k: v for k, v in row.items() if not k.endswith("_s") and k != "seconds"}
        for row in read_runs(folder / "results.parquet")
    ]


@pytest.mark.slow
def test_shards_of_which_one_was_killed_equal_one_sweep(tmp_path):
    scene, plan = tmp_path / "scene.json", tmp_path / "plan.yaml"
    scene.write_text(stored_scene("crowded_2").to_json())
    plan.write_text(yaml.safe_dump(PLAN | {"scenes": [str(scene)]}))
    command(plan, "--out", tmp_path / "whole")
    shards = [tmp_path / f"shard{k}" for k in (1, 2, 3, 4)]
    for k in (1, 2, 4):
        command(plan, "--out", shards[k - 1], "--shard", f"{k}/4")
    killed = command(plan, "--out", shards[2], "--shard", "3/4", wait=False)
    while killed.poll() is None and not (shards[2] / "results.parquet").exists():
        time.sleep(0.05)
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    before = len(read_runs(shards[2] / "results.parquet"))
    assert 0 < before < 128
    command(plan, "--out", shards[2], "--shard", "3/4", "--resume")
    command("merge", *shards, "--out", tmp_path / "merged")
    whole = bits(tmp_path / "whole")
    assert len(whole) == 512 and bits(tmp_path / "merged") == whole
    assert len({row["reward"] for row in whole}) > 64


@pytest.mark.slow
def test_ray_loses_a_worker_and_its_driver_and_the_table_is_that_of_one_process(tmp_path):
    pytest.importorskip("ray")
    psutil = pytest.importorskip("psutil")
    scene, plan = tmp_path / "scene.json", tmp_path / "plan.yaml"
    scene.write_text(stored_scene("crowded_2").to_json())
    plan.write_text(yaml.safe_dump(PLAN | {"scenes": [str(scene)], "seeds": 2}))
    command(plan, "--out", tmp_path / "whole")
    out, on_ray = tmp_path / "ray", ("--ray", "local", "--workers", 2)
    driver = command(plan, "--out", out, *on_ray, wait=False)

    def rows():
        file = out / "results.parquet"
        return len(read_runs(file)) if file.exists() else 0

    def wait_for(more):
        while driver.poll() is None and rows() < more:
            time.sleep(0.2)

    wait_for(2)
    workers = [p for p in psutil.Process(driver.pid).children(recursive=True)
               if any("run_in_worker" in word for word in p.cmdline())]  # fmt: skip
    assert workers
    workers[0].kill()
    wait_for(rows() + 8)
    # Ray's own processes end when the driver's socket closes.
    driver.send_signal(signal.SIGKILL)
    assert driver.wait() == -signal.SIGKILL and 8 <= rows() < 128
    command(plan, "--out", out, "--resume", *on_ray)
    assert bits(out) == bits(tmp_path / "whole") and len(bits(out)) == 128

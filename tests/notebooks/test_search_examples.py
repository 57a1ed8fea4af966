"""The examples of the search run as they stand.

Of the slow ones, the default suite makes the same calls elsewhere: Algorithm 1 by hand in
tests/search/test_algorithm.py, one program for several weights in tests/search/test_cem.py,
gradients in test_gradients.py, a reward of the rollout in test_rewards.py there.
"""

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import neoworld_mjx as nw
from neoworld_mjx.config import CEMOptions
from tests.support.scenes import compile_scene, stored_scene

FOLDER = Path(__file__).parents[2] / "examples" / "search"


def run(name, capsys):
    runpy.run_path(str(FOLDER / name), run_name="__main__")
    return capsys.readouterr().out


def numbers(pattern, text):
    return [float(x) for x in re.findall(pattern, text)]


def test_every_example_is_short_and_tested():
    tested = re.findall(r'"(\w+\.(?:py|sh))"', Path(__file__).read_text(encoding="utf-8"))
    assert sorted(tested) == sorted(path.name for path in FOLDER.glob("*.*"))
    for path in FOLDER.glob("*.*"):
        lines = path.read_text(encoding="utf-8").splitlines()
        assert len(lines) <= 60, path.name


@pytest.mark.slow
def test_asking_and_telling_by_hand_improves_the_best(capsys):
    best = numbers(r"best (-?[\d.]+)", run("1_ask_and_tell.py", capsys))
    assert len(best) == 3 and best[-1] > best[0]


@pytest.mark.slow
def test_one_program_searches_with_several_weights(capsys):
    drifts = numbers(r"w_drift \d: ([\d.]+)", run("2_vmap_over_weights.py", capsys))
    assert len(drifts) == 9 and drifts[5] < drifts[3]  # Weights 4 and 0, after a step.


@pytest.mark.slow
def test_a_reward_reads_the_rollout(capsys):
    said = run("3_reward_of_the_rollout.py", capsys)
    assert said.startswith("32 rollouts")
    (speed,) = numbers(r"winner: ([\d.]+) m/s", said)
    assert 0 <= speed < 0.05


@pytest.mark.slow
def test_gradient_steps_reduce_the_penetration(capsys):
    depths = numbers(r"D_pen ([\d.]+) mm", run("4_gradient_step.py", capsys))
    assert depths[0] > 5 and depths[-1] < 0.05 * depths[0]


def test_an_optimizer_of_ones_own_searches(capsys):
    assert re.match(r"\d+ iterations, passed: True", run("5_custom_optimizer.py", capsys))


def test_a_strategy_of_evosax_draws_what_it_draws_by_itself():
    """The same keys give the same populations as evosax's own loop on the same losses."""
    algorithms = pytest.importorskip("evosax.algorithms", reason="needs the extra baselines")
    module = runpy.run_path(str(FOLDER / "evosax_optimizer.py"))
    scene, options = compile_scene(stored_scene("crowded_2"), samples=16), CEMOptions(population=8)
    optimizer, flat = module["__getattr__"]("SNES")(scene, options), module["flat"]
    zero, free = nw.Layout.zero(1, scene.count), np.asarray(optimizer.free)
    es = algorithms.algorithms["SNES"](8, np.zeros(len(free), np.float32))
    params, state = es.default_params, optimizer.init(zero)
    inner = es.init(jax.random.key(0), jnp.zeros(len(free)), params)
    for t in range(3):
        key = jax.random.key(t)
        layouts = optimizer.ask(key, state, 8)
        drawn, inner = es.ask(key, inner, params)
        found = flat(layouts)[:, free] / flat(optimizer.sigma)[:, free]
        np.testing.assert_allclose(found, drawn, rtol=2e-4, atol=2e-4)
        loss = jnp.sum((drawn - 0.7) ** 2, axis=1)
        inner, _ = es.tell(jax.random.fold_in(key, 1), drawn, loss, inner, params)
        state = optimizer.tell(state, layouts, -loss, key=key)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_loop_of_ones_own_pushes_an_object(capsys):
    moved = numbers(r"moved ([\d.]+) mm", run("6_mjx_loop.py", capsys))
    assert len(moved) == 8 and moved[0] < 2 and moved[-1] > 5 and moved == sorted(moved)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_study_finds_options(capsys):
    pytest.importorskip("optuna")
    (best,) = numbers(r"4 trials, best reward (-?[\d.]+)", run("optuna_study.py", capsys))
    assert -3 < best < 2


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_tracker_receives_every_iteration(capsys, tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    assert "iterations logged" in run("track_with_wandb.py", capsys)
    (file,) = (tmp_path / "wandb").glob("offline-run-*/*.wandb")
    data = file.read_bytes()
    assert data.count(b"d_drift") >= 3


@pytest.mark.slow
def test_a_job_array_computes_shards_and_merges_them(tmp_path):
    scene, plan, out = tmp_path / "scene.json", tmp_path / "plan.yaml", tmp_path / "out"
    scene.write_text(stored_scene("crowded_2").to_json())
    search = {"cem": {"population": 8, "iterations": 1}, "rollout": {"engine": "native"}}
    axes = {"refine.reward.w_drift": [0.5, 1.0]}
    requests = {"scenes": [str(scene)], "seeds": 2, "base": {"refine": search}, "axes": axes}
    plan.write_text(yaml.safe_dump(requests))
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

    def job(*words, task="1"):
        slurm = {"SLURM_ARRAY_TASK_ID": task, "SLURM_ARRAY_TASK_COUNT": "2", "PATH": path}
        line = ["bash", str(FOLDER / "slurm_array.sh"), *map(str, words)]
        subprocess.run(line, check=True, capture_output=True, env=os.environ | slurm)

    for task in ("1", "2"):
        job("sweep", plan, out, task=task)
    job("merge", out)
    about = json.loads((out / "all" / "sweep.json").read_text())
    assert (about["finished"], about["missing"]) == (True, 0)
    assert (out / "all" / "table.md").exists()

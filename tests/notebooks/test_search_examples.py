"""The numbered examples of the search run as they stand.

Of the slow ones, the default suite makes the same calls elsewhere: Algorithm 1 by hand in
tests/refinement/test_algorithm.py, one program for several weights in tests/refinement/test_cem.py,
a reward of the rollout in tests/refinement/test_rewards.py, a loop over MJX steps in
test_mjx_loop.py.
"""

import re
import runpy
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "examples" / "search"


def run(name, capsys):
    path = FOLDER / name
    code = [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    assert len(code) <= 30
    runpy.run_path(str(path), run_name="__main__")
    return capsys.readouterr().out


def numbers(pattern, text):
    return [float(x) for x in re.findall(pattern, text)]


def test_every_example_is_tested():
    tested = re.findall(r'run\("(\d_\w+\.py)"', Path(__file__).read_text(encoding="utf-8"))
    assert sorted(tested) == sorted(path.name for path in FOLDER.glob("*.py"))


@pytest.mark.slow
def test_asking_and_telling_by_hand_improves_the_elites(capsys):
    elites = numbers(r"elites (-?[\d.]+)", run("1_ask_and_tell.py", capsys))
    assert len(elites) == 3 and elites[-1] > elites[0]


@pytest.mark.slow
def test_one_program_searches_with_several_weights(capsys):
    drifts = numbers(r"w_drift \d: ([\d.]+)", run("2_vmap_over_weights.py", capsys))
    assert len(drifts) == 9 and drifts[8] < drifts[6]  # Weights 4 and 0, at the end.


@pytest.mark.slow
def test_a_reward_reads_the_rollout(capsys):
    said = run("3_reward_of_the_rollout.py", capsys)
    assert said.startswith("33 rollouts")
    (speed,) = numbers(r"scene: ([\d.]+) m/s", said)
    assert 0 <= speed < 0.05


def test_gradient_steps_reduce_the_penetration(capsys):
    depths = numbers(r"D_pen ([\d.]+) mm", run("4_gradient_step.py", capsys))
    assert depths[0] > 5 and depths[-1] < 0.05 * depths[0]


def test_an_optimizer_of_ones_own_searches(capsys):
    assert re.match(r"\d+ iterations, passed: True", run("5_custom_optimizer.py", capsys))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_loop_of_ones_own_pushes_an_object(capsys):
    moved = numbers(r"moved ([\d.]+) mm", run("6_mjx_loop.py", capsys))
    assert len(moved) == 8 and moved[0] < 2 and moved[-1] > 5 and moved == sorted(moved)

"""Tasks in this process, in processes, on a local Ray cluster and on submitit's local executor."""

import os
import signal
from pathlib import Path

import pytest

from neoworld_mjx.errors import ConfigError, EngineError, RunError, SpecError
from neoworld_mjx.places import Place, check_place, on_slurm, run_tasks
from neoworld_mjx.places.place import run_in_worker
from neoworld_mjx.run_folder import versions


def squares(number: int):
    if number < 0:
        raise SpecError(f"{number} is negative")
    yield number
    yield number**2


def dying(number: int):
    os._exit(number)


def dying_once(marker: str):
    """Lose the worker the first time, as an evicted or preempted one is lost."""
    if not Path(marker).exists():
        Path(marker).write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    yield marker


def failing(number: int):
    raise ZeroDivisionError(str(number))
    yield


def test_this_process_yields_one_result_after_the_other():
    results = run_tasks(squares, [2, -1, 3])
    assert [next(results), next(results)] == [2, 4]
    with pytest.raises(SpecError, match="-1 is negative"):
        next(results)


def test_threads_share_the_cores(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 16)
    assert Place(workers=0).processes == 8 and Place(workers=0).threads == 2
    assert Place(workers=15).threads == 1 and Place(workers=1).threads == 16
    assert Place(ray="local", workers=2, task_cores=3).threads == 3


def test_a_worker_with_other_versions_is_refused():
    returned = run_in_worker(squares, 2, versions() | {"jax": "0.0.1"})
    assert isinstance(returned, RunError) and "this machine has 0.0.1" in str(returned)
    assert run_in_worker(squares, 2, versions()) == [2, 4]


@pytest.mark.parametrize(
    ("place", "error", "message"),
    [
        (Place(ray="local", slurm="local"), ConfigError, "cannot be combined"),
        (Place(workers=-1), ConfigError, "--workers and --task-gpus take 0 or more"),
        (Place(task_cores=0), ConfigError, "--task-cores 1 or more"),
    ],
)
def test_a_place_that_cannot_be_is_refused_before_anything_runs(place, error, message):
    with pytest.raises(error, match=message):
        check_place(place)
    with pytest.raises(error, match=message):
        list(run_tasks(squares, [2], place))


def test_without_ray_and_submitit_a_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    monkeypatch.setitem(__import__("sys").modules, "submitit", None)
    with pytest.raises(EngineError, match="--extra ray"):
        check_place(Place(ray="local"))
    with pytest.raises(EngineError, match="--extra slurm"):
        check_place(Place(slurm="local"))


@pytest.mark.slow
def test_several_processes():
    assert sorted(run_tasks(squares, [2, 3], Place(workers=2))) == [2, 3, 4, 9]
    with pytest.raises(SpecError, match="-1 is negative"):
        list(run_tasks(squares, [2, -1], Place(workers=2)))
    with pytest.raises(RunError, match="a process died"):
        list(run_tasks(dying, [3, 4], Place(workers=2)))


@pytest.mark.parametrize(
    ("address", "error", "message"),
    [
        ("127.0.0.1:1", EngineError, "no Ray cluster answers"),
        ("nowhere", ConfigError, "takes local or HOST:PORT"),
        ("nowhere:x", ConfigError, "takes local or HOST:PORT"),
    ],
)
def test_a_dead_ray_address_is_one_message(address, error, message):
    pytest.importorskip("ray")
    with pytest.raises(error, match=message):
        check_place(Place(ray=address))


# Ray forks; JAX warns of that where an earlier test has imported it.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.slow
def test_ray_repeats_the_task_of_a_lost_worker(tmp_path):
    pytest.importorskip("ray")
    place = Place(ray="local", workers=2)
    assert sorted(run_tasks(squares, [2, 3], place)) == [2, 3, 4, 9]
    markers = [str(tmp_path / name) for name in "ab"]
    assert sorted(run_tasks(dying_once, markers, place)) == markers
    with pytest.raises(SpecError, match="-1 is negative"):
        list(run_tasks(squares, [2, -1], place))
    with pytest.raises(ZeroDivisionError):
        list(run_tasks(failing, [2], place))
    with pytest.raises(RunError, match="was lost 4 times"):
        list(run_tasks(dying, [3], place))
    with pytest.raises(ConfigError, match="a task needs 8 GPU, the cluster has 0"):
        list(run_tasks(squares, [2], Place(ray="local", workers=1, task_gpus=8)))


@pytest.mark.slow
def test_submitit_repeats_the_task_of_a_lost_worker(tmp_path, monkeypatch):
    pytest.importorskip("submitit")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(on_slurm, "RETRIES", 1)
    place = Place(slurm="local", workers=2)
    marker = str(tmp_path / "begun")
    assert list(run_tasks(dying_once, [marker], place)) == [marker]
    assert sorted(run_tasks(squares, [2, 3], place)) == [2, 3, 4, 9]
    for work, number, error, message in (
        (squares, -1, SpecError, "-1 is negative"),
        (failing, 2, RuntimeError, "ZeroDivisionError"),
        (dying, 3, RunError, "was lost 2 times"),
    ):
        with pytest.raises(error, match=message):
            list(run_tasks(work, [number], place))


def test_the_script_in_the_documentation_is_what_slurm_gets(tmp_path, monkeypatch):
    submitit = pytest.importorskip("submitit")
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}")  # srun and sbatch
    text = "slurm_partition=gpu,timeout_min=60"
    executor = on_slurm.open_executor(Place(slurm=text, task_cores=4, task_gpus=1), "slurm")
    script = executor._executor._make_submission_file_text("COMMAND", "ID")
    wanted = [line for line in script.splitlines() if line.startswith("#SBATCH")]
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "sweeps.md").read_text()
    shown = [line.strip() for line in page.splitlines() if line.strip().startswith("#SBATCH")]
    kept = [line for line in wanted if not line.startswith(("#SBATCH --output", "#SBATCH --error"))]
    assert shown == kept and submitit.__version__


def test_invalid_parameters_of_slurm_are_one_message(monkeypatch):
    pytest.importorskip("submitit")
    monkeypatch.setenv("PATH", "")
    for text, error, message in (
        ("partition", ConfigError, "submitit's parameters as KEY=VALUE"),
        ("slurm_partitoin=gpu", ConfigError, "slurm_partitoin"),
        ("slurm_partition=gpu", EngineError, "sbatch is not installed"),
    ):
        with pytest.raises(error, match=message):
            check_place(Place(slurm=text))

"""Tasks in this process, in processes and on a local Ray cluster."""

import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from neoworld_mjx.errors import ConfigError, EngineError, RunError, SpecError
from neoworld_mjx.machines import Machines, check_machines, run_tasks

# Without an import: `machines` sets Ray's environment before it imports Ray.
needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="needs the extra ray")


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


@pytest.mark.parametrize(
    "machines", [Machines(workers=-1), Machines(task_gpus=-1), Machines(task_cores=0)]
)
def test_an_invalid_machine_is_refused_before_anything_runs(machines):
    message = "--workers and --task-gpus take 0 or more, and --task-cores 1 or more"
    with pytest.raises(ConfigError, match=message):
        check_machines(machines)
    with pytest.raises(ConfigError, match=message):
        list(run_tasks(squares, [2], machines))


def test_without_ray_a_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(EngineError, match="--extra ray"):
        check_machines(Machines(ray="local"))


@pytest.mark.slow
def test_several_processes():
    assert sorted(run_tasks(squares, [2, 3], Machines(workers=2))) == [2, 3, 4, 9]
    with pytest.raises(SpecError, match="-1 is negative"):
        list(run_tasks(squares, [2, -1], Machines(workers=2)))
    with pytest.raises(RunError, match="a process died"):
        list(run_tasks(dying, [3, 4], Machines(workers=2)))


def waiting(file: str):
    Path(file).write_text(str(os.getpid()))
    time.sleep(60)
    yield file


def test_processes_end_with_the_command_that_was_killed(tmp_path):
    file = tmp_path / "pid"
    code = f"""
from neoworld_mjx.machines import Machines, run_tasks
from tests.test_machines import waiting
if __name__ == "__main__":
    list(run_tasks(waiting, [{str(file)!r}, {str(file)!r}], Machines(workers=2)))
"""
    command = tmp_path / "command.py"
    command.write_text(code)
    root = str(Path(__file__).parents[1])
    path = os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(
        [sys.executable, str(command)], env={**os.environ, "PYTHONPATH": path}
    )
    try:
        assert eventually(lambda: file.exists() and file.read_text())
    finally:
        process.kill()
        process.wait()
    worker = Path("/proc") / file.read_text()
    assert eventually(lambda: not worker.exists())


def eventually(holds) -> bool:
    end = time.monotonic() + 30.0
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


@needs_ray
@pytest.mark.parametrize(
    ("address", "error", "message"),
    [
        ("127.0.0.1:1", EngineError, "no Ray cluster answers"),
        ("nowhere", ConfigError, "takes local or HOST:PORT"),
        ("nowhere:x", ConfigError, "takes local or HOST:PORT"),
    ],
)
def test_a_dead_ray_address_is_one_message(address, error, message):
    with pytest.raises(error, match=message):
        check_machines(Machines(ray=address))


# Ray forks; JAX warns of that where an earlier test has imported it.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.slow
@needs_ray
def test_ray_repeats_the_task_of_a_lost_worker(tmp_path):
    machines = Machines(ray="local", workers=2)
    assert sorted(run_tasks(squares, [2, 3], machines)) == [2, 3, 4, 9]
    markers = [str(tmp_path / name) for name in "ab"]
    assert sorted(run_tasks(dying_once, markers, machines)) == markers
    with pytest.raises(SpecError, match="-1 is negative"):
        list(run_tasks(squares, [2, -1], machines))
    with pytest.raises(ZeroDivisionError):
        list(run_tasks(failing, [2], machines))
    with pytest.raises(RunError, match="was lost 4 times"):
        list(run_tasks(dying, [3], machines))
    with pytest.raises(ConfigError, match="a task needs 8 GPU, but the cluster has 0"):
        list(run_tasks(squares, [2], Machines(ray="local", workers=1, task_gpus=8)))

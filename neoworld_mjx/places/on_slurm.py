"""Runs tasks as Slurm jobs that submitit submits (extra `slurm`)."""

import contextlib
import shutil
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..errors import ConfigError, EngineError, RunError
from ..io.yaml_files import parse_yaml
from ..run_folder import versions
from .place import RETRIES, Place, Result, Task, Work, results_of, run_in_worker

LOCAL = "local"
JOBS = Path("slurm_jobs")
"""Folder of submitit's files, relative to the working directory; all machines must share it."""
POLL_S = 0.5


def open_submitit() -> Any:
    """Import submitit.

    Raises:
        EngineError: submitit is not installed.
    """
    try:
        import submitit  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise EngineError("--slurm needs submitit: uv sync --inexact --extra slurm") from None
    return submitit


def check_slurm(text: str) -> None:
    """Check that submitit and Slurm are installed and that submitit's parameters are valid.

    Raises:
        ConfigError: `text` is malformed, or submitit rejects a parameter.
        EngineError: submitit or Slurm is missing.
    """
    submitit = open_submitit()
    parameters = _parameters(text)
    try:
        submitit.AutoExecutor(JOBS, cluster="debug").update_parameters(**parameters)
    except (NameError, TypeError, ValueError) as error:
        raise ConfigError(f"--slurm {text}: {error}") from None
    if text != LOCAL and shutil.which("sbatch") is None:
        raise EngineError("--slurm: sbatch is not installed; --slurm local runs without Slurm")


def _parameters(text: str) -> dict[str, Any]:
    """Parse submitit's parameters from a string KEY=VALUE,KEY=VALUE."""
    if text == LOCAL:
        return {}
    parameters = {}
    for part in filter(None, text.split(",")):
        key, equals, value = part.partition("=")
        if not equals or not key.isidentifier():
            raise ConfigError(
                "--slurm takes local, or submitit's parameters as KEY=VALUE,KEY=VALUE, such as "
                f"slurm_partition=gpu,timeout_min=60; got {part!r}"
            )
        try:
            parameters[key] = parse_yaml(value)
        except ValueError as error:
            raise ConfigError(f"--slurm: {key}: {error}") from None
    return parameters


def open_executor(place: Place, cluster: str) -> Any:
    """Return submitit's executor with the parameters of a place.

    Args:
        place: the place.
        cluster: "slurm", or "local" for processes on this machine.
    """
    executor = open_submitit().AutoExecutor(JOBS, cluster=cluster)
    executor.update_parameters(
        name="neoworld",
        cpus_per_task=place.task_cores,
        **({"gpus_per_node": place.task_gpus} if place.task_gpus else {}),
        **_parameters(place.slurm or LOCAL),
    )
    return executor


def run_on_slurm(work: Work[Task, Result], tasks: Sequence[Task], place: Place) -> Iterator[Result]:
    """Run tasks as jobs of a Slurm array; see `running.run_tasks`."""
    submitit = open_submitit()
    local = place.slurm == LOCAL
    executor = open_executor(place, LOCAL if local else "slurm")
    # Slurm queues jobs; without Slurm, all submitted jobs would start at once.
    max_active = place.processes if local else len(tasks)
    queue = [(task, 0) for task in tasks]
    active: dict[Any, tuple[Any, int]] = {}
    try:
        while queue or active:
            started, queue = queue[: max_active - len(active)], queue[max_active - len(active) :]
            if started:
                with executor.batch():
                    jobs = [
                        executor.submit(run_in_worker, work, task, versions())
                        for task, _ in started
                    ]
                active |= dict(zip(jobs, started, strict=True))
            ended = [job for job in active if job.done()]
            if not ended:
                time.sleep(POLL_S)
            for job in ended:
                task, tries = active.pop(job)
                try:
                    returned = job.result()
                except submitit.core.utils.FailedJobError as error:  # The task raised.
                    raise RuntimeError(str(error)) from None
                except submitit.core.utils.UncompletedJobError:  # The worker is lost.
                    if tries == RETRIES:
                        raise RunError(
                            f"--slurm {place.slurm}: the worker of a task was lost {tries + 1} "
                            f"times, see {job.paths.stderr}; finished tasks are kept"
                        ) from None
                    queue.append((task, tries + 1))
                else:
                    yield from results_of(returned)
    finally:
        with contextlib.suppress(Exception):
            for job in active:
                job.cancel()

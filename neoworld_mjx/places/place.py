"""Options of the place where tasks run, and the function that runs a task in a worker."""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from typing import TypeVar

from ..cache import keep_compilations
from ..errors import NeoWorldError, RunError

Task = TypeVar("Task")
Result = TypeVar("Result")
Work = Callable[[Task], Iterable[Result]]
"""Module-level function, or `functools.partial` of one, that maps a task to the task's results."""
RETRIES = 3
"""Number of times that a task is repeated if its worker on a cluster is lost."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """Options of the place where tasks run; by default, this process."""

    workers: int = 1
    """Number of processes; 0 starts one process for every two cores. With --ray local or --slurm
    local, the number of tasks that the local cluster runs at once."""
    ray: str | None = None
    """Address of a Ray cluster, such as HOST:6379, or `local` to start a local cluster."""
    slurm: str | None = None
    """Run tasks as Slurm jobs: submitit's parameters, such as slurm_partition=gpu,timeout_min=60,
    or `local` to run processes without Slurm."""
    task_cores: int = 1
    """Number of CPU cores of each task on a cluster."""
    task_gpus: int = 0
    """Number of GPUs of each task on a cluster."""

    @property
    def place(self) -> "Place":
        """Copy of these options without the options that a subclass adds."""
        return Place(**{field.name: getattr(self, field.name) for field in fields(Place)})

    @property
    def remote(self) -> bool:
        """True if tasks run on a cluster."""
        return self.ray is not None or self.slurm is not None

    @property
    def processes(self) -> int:
        """Number of processes on this machine."""
        return self.workers or max(1, (os.cpu_count() or 1) // 2)

    @property
    def threads(self) -> int:
        """Number of threads of each process."""
        if self.remote:
            return self.task_cores
        return max(1, (os.cpu_count() or 1) // self.processes)


def run_in_worker(
    work: Work[Task, Result], task: Task, caller_versions: dict[str, str]
) -> list[Result] | NeoWorldError:
    """Run a task in a worker; return the task's results, or the error that the caller raises.

    Args:
        work: function that maps a task to its results.
        task: the argument of `work`.
        caller_versions: the caller's versions of the packages that affect results.
    """
    from ..run_folder import versions  # Imported late to keep `--help` fast.

    for name, version in versions().items():
        if caller_versions.get(name) != version:
            return RunError(
                f"worker {os.uname().nodename} has {name} {version}, this machine has "
                f"{caller_versions.get(name, 'none')}: install the same versions"
            )
    keep_compilations()
    try:
        return list(work(task))
    except NeoWorldError as error:
        return error


def results_of(returned: list[Result] | NeoWorldError) -> list[Result]:
    """Return the results that `run_in_worker` returned, or raise the error that it returned."""
    if isinstance(returned, NeoWorldError):
        raise returned
    return returned

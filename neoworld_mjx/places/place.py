"""Places where tasks run, and what a worker does there."""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from typing import TypeVar

from ..cache import keep_compilations
from ..errors import NeoWorldError, RunError

Task = TypeVar("Task")
Made = TypeVar("Made")
Work = Callable[[Task], Iterable[Made]]
"""Function of a module, or a `functools.partial` of one, from a task to its results."""
RETRIES = 3
"""Number of times that a task is repeated whose worker on a cluster is lost."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """A place for tasks to run; by default this process."""

    workers: int = 1
    """Processes; 0 starts one for every two cores. With --ray local and --slurm local, the size of
    the cluster."""
    ray: str | None = None
    """Run on the Ray cluster at this address, such as HOST:6379, or on a local one: `local`."""
    slurm: str | None = None
    """Run as Slurm jobs: `local` for processes without Slurm, or submitit's parameters, such as
    slurm_partition=gpu,timeout_min=60."""
    task_cores: int = 1
    """Cores of a task on a cluster."""
    task_gpus: int = 0
    """GPUs of a task on a cluster."""

    @property
    def place(self) -> "Place":
        """This place alone, where a command has these options among others."""
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
        """Threads of each process."""
        if self.remote:
            return self.task_cores
        return max(1, (os.cpu_count() or 1) // self.processes)


def work_there(
    work: Work[Task, Made], task: Task, wanted: dict[str, str]
) -> list[Made] | NeoWorldError:
    """Run a task in a worker; return its results, or the error that the user is to see.

    Args:
        work: function from a task to its results.
        task: the argument of `work`.
        wanted: versions of the packages that affect results, as the caller has them.
    """
    from ..run_folder import versions  # Help texts need places and nothing heavy.

    for name, version in versions().items():
        if wanted.get(name) != version:
            return RunError(
                f"worker {os.uname().nodename} has {name} {version}, here it is "
                f"{wanted.get(name, 'not installed')}: install the same versions"
            )
    keep_compilations()
    try:
        return list(work(task))
    except NeoWorldError as error:
        return error


def results_of(returned: list[Made] | NeoWorldError) -> list[Made]:
    """Return the results of `work_there`, or raise its error."""
    if isinstance(returned, NeoWorldError):
        raise returned
    return returned

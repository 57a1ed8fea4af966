"""Runs the tasks of a sweep, a benchmark or a folder of photographs at a place."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

from ..errors import ConfigError, RunError
from .place import Place, Result, Task, Work, results_of, run_in_worker

HERE = Place()
"""Place for tasks that run in this process."""


def check_place(place: Place) -> None:
    """Check that tasks can run at a place, before anything else is done.

    Raises:
        ConfigError: two clusters are given, or a number or a parameter is invalid.
        EngineError: the package of the cluster is missing, or the cluster does not answer.
    """
    if place.ray is not None and place.slurm is not None:
        raise ConfigError("--ray and --slurm cannot be combined: give one of them")
    if place.workers < 0 or place.task_cores < 1 or place.task_gpus < 0:
        raise ConfigError("--workers and --task-gpus take 0 or more, and --task-cores 1 or more")
    if place.ray is not None:
        from .on_ray import check_ray

        check_ray(place.ray)
    if place.slurm is not None:
        from .on_slurm import check_slurm

        check_slurm(place.slurm)


def run_tasks(
    work: Work[Task, Result], tasks: Sequence[Task], place: Place = HERE
) -> Iterator[Result]:
    """Run a function on tasks, and yield the results as they become available.

    In this process, results are yielded one by one, in the order of the tasks. In other processes
    and on a cluster, all results of a task are yielded together when the task ends. If a worker of
    a cluster is lost, its task is repeated on another worker.

    Args:
        work: function that maps a task to its results.
        tasks: arguments of `work`; unless tasks run in this process, tasks and results must be
            picklable.
        place: where the tasks run.

    Raises:
        RunError: a process died, the worker of a task was lost repeatedly, or a worker has
            different versions of the packages.
        NeoWorldError: a task raised this error.
    """
    check_place(place)
    if not tasks:
        return
    if place.ray is not None:
        from .on_ray import run_on_ray

        yield from run_on_ray(work, tasks, place)
    elif place.slurm is not None:
        from .on_slurm import run_on_slurm

        yield from run_on_slurm(work, tasks, place)
    elif place.processes == 1:
        for task in tasks:
            yield from work(task)
    else:
        yield from _run_in_processes(work, tasks, place)


def _run_in_processes(
    work: Work[Task, Result], tasks: Sequence[Task], place: Place
) -> Iterator[Result]:
    from ..run_folder import versions

    with ProcessPoolExecutor(place.processes, get_context("spawn")) as pool:
        futures = [pool.submit(run_in_worker, work, task, versions()) for task in tasks]
        try:
            for future in as_completed(futures):
                yield from results_of(future.result())
        except BrokenProcessPool:
            raise RunError(
                "a process died, perhaps out of memory: use fewer --workers; finished rows are kept"
            ) from None
        finally:
            # If the loop ends early, for example by Ctrl-C, cancel the tasks that have not begun.
            pool.shutdown(wait=False, cancel_futures=True)

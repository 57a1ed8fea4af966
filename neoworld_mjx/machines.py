"""Machines on which tasks run: this process, processes on this machine, or a Ray cluster.

Ray (Moritz et al., arXiv:1712.05889) is installed by the extra `ray`.
"""

import contextlib
import os
import socket
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, fields
from multiprocessing import get_context, parent_process
from typing import Any, TypeVar

from .cache import keep_compilations
from .errors import ConfigError, EngineError, NeoWorldError, RunError

Task = TypeVar("Task")
Result = TypeVar("Result")
Work = Callable[[Task], Iterable[Result]]
"""Module-level function, or `functools.partial` of one, that maps a task to the task's results."""
LOCAL = "local"
RETRIES = 3
"""Number of times that a task is repeated if its worker on a cluster is lost."""
CONNECT_S = 5.0
"""Timeout of the connection to a cluster [s]."""
STORE_BYTES = 256 << 20
"""Size of a local cluster's object store [bytes]; tasks and results are small."""


@dataclass(frozen=True, kw_only=True)
class Machines:
    """Options of the machines on which tasks run; by default, this process."""

    workers: int = 1
    """Number of processes; 0 starts one process for every two cores. With --ray local, the number
    of tasks that the local cluster runs at once."""
    ray: str | None = None
    """Address of a Ray cluster, such as HOST:6379, or `local` to start a local cluster."""
    task_cores: int = 1
    """Number of CPU cores of each task on a cluster."""
    task_gpus: int = 0
    """Number of GPUs of each task on a cluster."""

    @property
    def machines(self) -> "Machines":
        """Copy of these options without the options that a subclass adds."""
        return Machines(**{field.name: getattr(self, field.name) for field in fields(Machines)})

    @property
    def processes(self) -> int:
        """Number of processes on this machine."""
        return self.workers or max(1, (os.cpu_count() or 1) // 2)

    @property
    def threads(self) -> int:
        """Number of threads of each process."""
        if self.ray is not None:
            return self.task_cores
        return max(1, (os.cpu_count() or 1) // self.processes)


HERE = Machines()
"""Tasks run in this process."""


def check_machines(machines: Machines) -> None:
    """Check that tasks can run on machines, before anything else is done.

    Raises:
        ConfigError: a number or the address of the cluster is invalid.
        EngineError: Ray is not installed, or no cluster answers.
    """
    if machines.workers < 0 or machines.task_cores < 1 or machines.task_gpus < 0:
        raise ConfigError("--workers and --task-gpus take 0 or more, and --task-cores 1 or more")
    if machines.ray is None:
        return
    if _open_ray().is_initialized() or machines.ray == LOCAL:
        return
    host, _, port = machines.ray.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise ConfigError(
            f"--ray takes local or HOST:PORT, such as 10.0.0.1:6379, got {machines.ray!r}"
        )
    try:
        socket.create_connection((host, int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise EngineError(
            f"--ray {machines.ray}: no Ray cluster answers ({error}); start one with ray start "
            "--head, or use --ray local"
        ) from None


def run_tasks(
    work: Work[Task, Result], tasks: Sequence[Task], machines: Machines = HERE
) -> Iterator[Result]:
    """Run a function on tasks, and yield the results as they become available.

    In this process, results are yielded one by one, in the order of the tasks. In other processes
    and on a cluster, all results of a task are yielded together when the task ends. If a worker of
    a cluster is lost, its task is repeated on another worker.

    Args:
        work: function that maps a task to its results.
        tasks: arguments of `work`; unless tasks run in this process, tasks and results must be
            picklable.
        machines: where the tasks run.

    Raises:
        RunError: a process died, the worker of a task was lost repeatedly, or a worker has
            different versions of the packages.
        NeoWorldError: a task raised this error.
    """
    check_machines(machines)
    if not tasks or (machines.ray is None and machines.processes == 1):
        for task in tasks:
            yield from work(task)
        return
    from .run_folder import versions  # Imported late to keep `--help` fast.

    with _submitter(machines) as submit:
        futures = [submit(run_in_worker, work, task, versions()) for task in tasks]
        for future in as_completed(futures):
            results = future.result()
            if isinstance(results, NeoWorldError):
                raise results
            yield from results


def run_in_worker(
    work: Work[Task, Result], task: Task, caller_versions: dict[str, str]
) -> list[Result] | NeoWorldError:
    """Run a task in a worker; return the task's results, or the error that the caller raises.

    Args:
        work: function that maps a task to its results.
        task: the argument of `work`.
        caller_versions: the caller's versions of the packages that affect results.
    """
    from .run_folder import versions

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


def _end_with_parent() -> None:
    """End this worker when the process that started it has ended, even if it was killed."""
    parent = parent_process()
    assert parent is not None, "this process is no worker"

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def _submitter(machines: Machines) -> Iterator[Callable[..., Future[Any]]]:
    """Yield a function that submits a call to a worker, and cancel the calls that are left."""
    if machines.ray is not None:
        with _on_ray(machines) as submit:
            yield submit
        return
    pool = ProcessPoolExecutor(
        machines.processes, get_context("spawn"), initializer=_end_with_parent
    )
    try:
        yield pool.submit
    except BrokenProcessPool:
        raise RunError(
            "a process died, perhaps out of memory: use fewer --workers; finished rows are kept"
        ) from None
    finally:
        # If the loop ends early, for example by Ctrl-C, calls that have not begun are cancelled.
        pool.shutdown(wait=False, cancel_futures=True)


def _open_ray() -> Any:
    # Silence Ray's warning about a future default, which does not affect tasks.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    # Below `uv run`, Ray would start workers by `uv run` in a copy of the working directory.
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise EngineError("--ray needs ray: uv sync --inexact --extra ray") from None
    return ray


@contextlib.contextmanager
def _ray_session(ray: Any, machines: Machines) -> Iterator[None]:
    """Connect to a cluster or start a local one, unless Ray is already initialized."""
    if ray.is_initialized():
        yield
        return
    options: dict[str, Any] = {"address": machines.ray}
    if machines.ray == LOCAL:
        options |= {
            "num_cpus": machines.processes * machines.task_cores,
            "include_dashboard": False,
            "object_store_memory": STORE_BYTES,
        }
    try:
        ray.init(logging_level="ERROR", log_to_driver=False, **options)
    except Exception as error:  # Ray raises plain exceptions, for example if a node starts slowly.
        first = str(error).strip().split("\n", 1)[0]
        raise EngineError(f"--ray {machines.ray}: {first}") from None
    try:
        yield
    finally:
        ray.shutdown()


@contextlib.contextmanager
def _on_ray(machines: Machines) -> Iterator[Callable[..., Future[Any]]]:
    ray, references = _open_ray(), []
    with _ray_session(ray, machines):
        available = ray.cluster_resources()
        for name, required in (("CPU", machines.task_cores), ("GPU", machines.task_gpus)):
            if available.get(name, 0) < required:
                raise ConfigError(
                    f"--ray {machines.ray}: a task needs {required} {name}, but the cluster has "
                    f"{available.get(name, 0):g}"
                )

        def submit(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
            # Ray repeats a task only if its worker is lost, not if the task raises.
            remote = ray.remote(function).options(
                num_cpus=machines.task_cores, num_gpus=machines.task_gpus, max_retries=RETRIES
            )
            references.append(remote.remote(*arguments))
            return references[-1].future()

        try:
            yield submit
        except ray.exceptions.RayTaskError as error:
            raise error.cause from error
        except ray.exceptions.RayError as error:
            first = str(error).strip().split("\n", 1)[0]
            raise RunError(
                f"--ray {machines.ray}: the worker of a task was lost {RETRIES + 1} times, or the "
                f"cluster is gone ({first}); finished tasks are kept"
            ) from None
        finally:
            with contextlib.suppress(Exception):
                for reference in references:
                    ray.cancel(reference, force=True)

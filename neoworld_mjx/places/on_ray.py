"""Runs tasks on a Ray cluster (Moritz et al., arXiv:1712.05889; extra `ray`)."""

import contextlib
import os
import socket
from collections.abc import Iterator, Sequence
from typing import Any

from ..errors import ConfigError, EngineError, RunError
from ..run_folder import versions
from .place import RETRIES, Place, Result, Task, Work, results_of, run_in_worker

LOCAL = "local"
ANSWER_S = 5.0
"""Timeout of the connection to a cluster [s]."""
STORE_BYTES = 256 << 20
"""Size of a local cluster's object store [bytes]; tasks and results are small."""


def open_ray() -> Any:
    """Import Ray.

    Raises:
        EngineError: Ray is not installed.
    """
    # Silence Ray's warning about a future default, which does not affect tasks.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise EngineError("--ray needs ray: uv sync --inexact --extra ray") from None
    return ray


def check_ray(address: str) -> None:
    """Check that Ray is installed, and that a cluster answers at an address.

    Raises:
        ConfigError: `address` is not a valid address.
        EngineError: Ray is not installed, or no cluster answers.
    """
    ray = open_ray()
    if address == LOCAL or ray.is_initialized():
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise ConfigError(f"--ray takes local or HOST:PORT, such as 10.0.0.1:6379, got {address!r}")
    try:
        socket.create_connection((host, int(port)), ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise EngineError(
            f"--ray {address}: no Ray cluster answers ({error}); start one with ray start --head, "
            "or use --ray local"
        ) from None


@contextlib.contextmanager
def _session(ray: Any, place: Place) -> Iterator[None]:
    """Connect to a cluster or start a local one, unless Ray is already initialized."""
    if ray.is_initialized():
        yield
        return
    options: dict[str, Any] = {"address": place.ray}
    if place.ray == LOCAL:
        options |= {
            "num_cpus": place.processes * place.task_cores,
            "include_dashboard": False,
            "object_store_memory": STORE_BYTES,
        }
    try:
        ray.init(logging_level="ERROR", log_to_driver=False, **options)
    except Exception as error:  # Ray raises plain exceptions, for example if a node starts slowly.
        first = str(error).strip().split("\n", 1)[0]
        raise EngineError(f"--ray {place.ray}: {first}") from None
    try:
        yield
    finally:
        ray.shutdown()


def run_on_ray(work: Work[Task, Result], tasks: Sequence[Task], place: Place) -> Iterator[Result]:
    """Run tasks on a Ray cluster; see `running.run_tasks`."""
    ray = open_ray()
    with _session(ray, place):
        available = ray.cluster_resources()
        for name, required in (("CPU", place.task_cores), ("GPU", place.task_gpus)):
            if available.get(name, 0) < required:
                raise ConfigError(
                    f"--ray {place.ray}: a task needs {required} {name}, but the cluster has "
                    f"{available.get(name, 0):g}"
                )
        # Ray repeats a task only if its worker is lost, not if the task raises.
        remote = ray.remote(run_in_worker).options(
            num_cpus=place.task_cores, num_gpus=place.task_gpus, max_retries=RETRIES
        )
        waiting = [remote.remote(work, task, versions()) for task in tasks]
        try:
            while waiting:
                (done, *_), waiting = ray.wait(waiting)
                yield from results_of(ray.get(done))
        except ray.exceptions.RayTaskError as error:
            raise error.cause from error
        except ray.exceptions.RayError as error:
            first = str(error).strip().split("\n", 1)[0]
            raise RunError(
                f"--ray {place.ray}: the worker of a task was lost {RETRIES + 1} times, or the "
                f"cluster is gone ({first}); finished tasks are kept"
            ) from None
        finally:
            with contextlib.suppress(Exception):
                for reference in waiting:
                    ray.cancel(reference, force=True)

"""Calls of functions on untrusted files and programs in workers with limited time and memory.

The limits are those that are active in the current context (`file_bounds`).

A few bytes of glTF or MJCF can make a library allocate all memory, run for hours or crash. A
server process, started on the first call, imports the readers once and forks a worker for each
call. The operating system limits the processor time of each worker and, on Linux, its address
space. If a worker dies, the caller raises an error with a single message.

The command

    python -m neoworld_mjx.io.limited_worker FD

runs the server, which receives calls and sends results through an inherited connection.
"""

import atexit
import importlib
import math
import os
import pickle
import resource
import select
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import lru_cache, partial
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any, Literal, TypeVar

from ..errors import NeoWorldError, SpecError
from ..options import Options, option
from .files import MIB
from .names import plain_text


class FileOptions(Options):
    """Options that limit input files. A file that exceeds a limit is rejected with an error."""

    max_file_mib: int = option(
        256,
        "Maximum size of a file, and of the arrays in an .npz file after unpacking.",
        unit="MiB",
        ge=1,
        le=16384,
    )
    timeout_s: float = option(
        8.0,
        "Processor time limit of the worker process that reads an asset or a large image.",
        unit="s",
        gt=0,
        le=86400,
    )
    memory_mib: int = option(
        500,
        "Memory limit of the worker process on Linux: the address space that it may allocate after "
        "it is forked.",
        unit="MiB",
        ge=64,
        le=65536,
    )
    decompose_s: float = option(
        120.0,
        "Time limit for decomposing all meshes of an asset into convex pieces, within "
        "`memory_mib`; the remaining meshes are replaced by their convex hulls.",
        unit="s",
        gt=0,
        le=86400,
    )
    max_picture_mpx: int = option(
        134,
        "Maximum number of pixels of a photograph; common phone cameras reach 108 megapixels. "
        "A large photograph in a format other than JPEG reaches the limit `memory_mib` first.",
        unit="MP",
        ge=1,
        le=1000,
    )


_DEFAULTS = FileOptions()
_active: ContextVar[FileOptions] = ContextVar("file_bounds", default=_DEFAULTS)


def file_bounds() -> FileOptions:
    """Return the active limits: the limits of the current run, or the defaults."""
    return _active.get()


def set_file_bounds(options: FileOptions) -> None:
    """Activate limits in the current context, as the command line does."""
    _active.set(options)


@contextmanager
def bounded_by(options: FileOptions) -> Iterator[None]:
    """Activate limits for the duration of a `with` block."""
    token = _active.set(options)
    try:
        yield
    finally:
        _active.reset(token)


R = TypeVar("R")
_LINUX = sys.platform == "linux"
_WALL_FACTOR = 4.0
"""Ratio of the wall time limit, which ends workers that wait, to the processor time limit."""
_RESULT, _ERROR, _DEATH = range(3)
_OUT_OF_MEMORY = 97
"""Exit status of a worker that ran out of memory."""
_ONE_THREAD = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PXR_WORK_THREAD_LIMIT"), "1"),
    "MALLOC_ARENA_MAX": "1",
}
"""Environment variables that keep libraries single-threaded.

Each thread takes address space, and the processor time limit applies to the sum over threads.
"""
_lock = threading.Lock()


def call_limited(
    function: Callable[..., R],
    path: Path,
    *arguments: Any,
    needs: Sequence[str] = (),
    error: type[NeoWorldError] = SpecError,
    time_option: str = "timeout_s",
    timeout_s: float | None = None,
) -> R:
    """Call a function on untrusted data in a worker, within `files.timeout_s` and `memory_mib`.

    Args:
        function: a module-level function; `path` is its first argument.
        path: the file that the function reads, or a name for the data in messages.
        arguments: further arguments; all must be picklable.
        needs: modules that `function` imports when it is called; the server imports them before
            it forks.
        error: class of the errors to raise.
        time_option: name of the option of `files` that limits the processor time.
        timeout_s: limit of the processor time [s] if it is smaller than the option.

    Raises:
        NeoWorldError: of the class `error`: the function raised an exception, or the worker
            exceeded its limits or crashed.
        OSError: the server cannot be started.
    """
    bounds = file_bounds()
    allowed_s = getattr(bounds, time_option)
    try:
        return run_limited(
            function,
            (path, *arguments),
            needs=needs,
            timeout_s=min(allowed_s, timeout_s or allowed_s),
            memory_mib=bounds.memory_mib,
        )
    except WorkerFailedError as failure:
        raise error(str(failure)) from None
    except WorkerEndedError as end:
        if end.reason == "lost":
            raise error(f"{path}: the process that reads files has died") from None
        if end.reason == "time":
            raise error(
                f"{path}: it takes over {allowed_s:g} s to read; make the file smaller, or "
                f"raise files.{time_option} if you trust it"
            ) from None
        crash = f", or crashes its reader (status {end.status})" if end.reason == "crash" else ""
        raise error(
            f"{path}: it takes over {bounds.memory_mib} MiB of memory to read{crash}; make the "
            "file smaller, or raise files.memory_mib if you trust it"
        ) from None


class WorkerFailedError(Exception):
    """The function raised an exception in the worker; the message describes it."""


class WorkerEndedError(Exception):
    """The worker exceeded a limit or crashed."""

    def __init__(self, reason: Literal["time", "memory", "crash", "lost"], status: int = 0) -> None:
        """Store why the worker ended: "lost" if its server has died, and its exit status."""
        super().__init__(reason)
        self.reason, self.status = reason, status


def run_limited(
    function: Callable[..., R],
    arguments: Sequence[Any],
    *,
    needs: Sequence[str] = (),
    timeout_s: float,
    memory_mib: int,
    wall_factor: float = _WALL_FACTOR,
) -> R:
    """Call a function in a worker; the calls of a process run one after another.

    Args:
        function: a module-level function.
        arguments: its arguments, which must be picklable.
        needs: modules that `function` imports when it is called; the server imports them before
            it forks.
        timeout_s: limit of the processor time of the worker, and of each process that it starts
            [s], rounded up to whole seconds. At the limit, the process receives SIGXCPU; one second
            later, it is killed.
        memory_mib: limit of the address space that the worker may allocate [MiB], on Linux.
        wall_factor: ratio of the limit of wall time to `timeout_s`.

    Raises:
        WorkerFailedError: the function raised an exception.
        WorkerEndedError: the worker exceeded a limit or crashed.
        OSError: the server cannot be started.
    """
    bounds = file_bounds().model_copy(update={"timeout_s": timeout_s, "memory_mib": memory_mib})
    call = (function, tuple(arguments), tuple(needs), bounds, wall_factor, Path.cwd())
    with _lock:
        try:
            _, connection = _server(os.getpid())
            connection.send_bytes(pickle.dumps(call))
            kind, payload = connection.recv()
        except BaseException as failure:
            _stop()  # A late result must not be taken for the result of the next call.
            if isinstance(failure, EOFError | ConnectionError):
                raise WorkerEndedError("lost") from None
            raise
    if kind == _RESULT:
        return pickle.loads(payload)
    if kind == _ERROR:
        raise WorkerFailedError(payload.decode())
    status = int(payload)
    if -status in (signal.SIGXCPU, signal.SIGKILL):
        raise WorkerEndedError("time", status)
    raise WorkerEndedError("memory" if status == _OUT_OF_MEMORY else "crash", status)


@lru_cache(maxsize=1)
def _server(pid: int) -> "tuple[subprocess.Popen[bytes], Connection]":
    """Return the server of the process `pid`; the first call starts the server."""
    del pid
    package = str(Path(__file__).parents[2])
    inherited = os.environ.get("PYTHONPATH")
    path = package if inherited is None else f"{package}{os.pathsep}{inherited}"
    connection, end = Pipe()
    with end:
        process = subprocess.Popen(
            [sys.executable, "-m", __name__, str(end.fileno())],
            pass_fds=[end.fileno()],
            stdin=subprocess.DEVNULL,
            # Libraries may print strings from the file, and these may control the terminal.
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ | _ONE_THREAD | {"PYTHONPATH": path},
            process_group=0,
        )
    return process, connection  # pyright: ignore[reportReturnType]


@atexit.register
def _stop() -> None:
    """Kill the server of this process and its worker, if the server has been started."""
    if _server.cache_info().currsize:
        process, connection = _server(os.getpid())
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        connection.close()
    _server.cache_clear()


def _serve(connection: Connection) -> None:
    """Answer calls until the caller ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # The caller ends this process.
    while True:
        try:
            data = connection.recv_bytes()
        except (EOFError, ConnectionError):
            return
        try:
            function, arguments, needs, bounds, wall_factor, folder = pickle.loads(data)
            for name in needs:
                importlib.import_module(name)
            output = tempfile.TemporaryFile()  # noqa: SIM115 - closed below
        except Exception as failure:
            connection.send((_ERROR, f"{type(failure).__name__}: {failure}".encode()))
            continue
        with output:
            alive, held = os.pipe()
            pid = os.fork()
            if not pid:
                os.chdir(folder)
                set_file_bounds(bounds)
                _work(output, arguments[0], partial(function, *arguments))
            os.close(held)
            # `alive` becomes readable when the worker ends, `connection` when the caller ends.
            wall_s = bounds.timeout_s * wall_factor
            if alive not in select.select([alive, connection], [], [], wall_s)[0]:
                os.kill(pid, signal.SIGKILL)
            os.close(alive)
            status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            if status in (_RESULT, _ERROR):
                output.seek(0)
                connection.send((status, output.read()))
            else:
                connection.send((_DEATH, str(status).encode()))


def _work(output: IO[bytes], path: Path, call: Callable[[], Any]) -> None:
    """Call a function in a worker, write the result or the error, and end the process."""
    status = _RESULT
    try:
        _limit()
        pickle.dump(call(), output, protocol=5)
        output.flush()
    except MemoryError:
        status = _OUT_OF_MEMORY
    except BaseException as failure:
        text = str(failure)
        if not isinstance(failure, NeoWorldError):
            reason = plain_text(f"{type(failure).__name__}: {failure}", 300)
            text = (
                f"{path} cannot be read ({reason}); make the file smaller, or raise "
                "files.memory_mib if you trust it"
            )
        output.seek(0)
        output.truncate()
        output.write(text.encode("utf-8", "replace"))
        output.flush()
        status = _ERROR
    finally:
        os._exit(status)


def _limit() -> None:
    """Limit the address space, the processor time and the file size of this process."""
    bounds = file_bounds()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _lower(resource.RLIMIT_CORE, 0)
    if _LINUX:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        space = pages * resource.getpagesize() + bounds.memory_mib * MIB
        _lower(resource.RLIMIT_AS, space)
    seconds = math.ceil(bounds.timeout_s)
    _lower(resource.RLIMIT_CPU, seconds, seconds + 1)
    _lower(resource.RLIMIT_FSIZE, bounds.memory_mib * MIB)


def _lower(kind: int, soft: int, hard: int | None = None) -> None:
    """Lower a limit of this process; a lower limit of the caller's shell stays."""
    current = resource.getrlimit(kind)[1]
    largest = float("inf") if current == resource.RLIM_INFINITY else current
    allowed = [int(min(value, largest)) for value in (soft, soft if hard is None else hard)]
    resource.setrlimit(kind, (allowed[0], allowed[1]))


if __name__ == "__main__":
    # Called functions use the limits of the imported package, so __main__ must not serve them.
    from neoworld_mjx.io import limited_worker

    limited_worker._serve(Connection(int(sys.argv[1])))

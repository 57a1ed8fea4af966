"""Interruption of SDK calls that take too long, and the processor time of a worker process."""

import contextlib
import ctypes
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_POLL_S = 0.05
_REPEAT_S = 1.0
"""Processor time [s] after which a call that is still running is interrupted again.

The first interruption can be lost, because Python ignores exceptions that are raised in callbacks
of the garbage collector.
"""


class CallInterrupted(BaseException):
    """Raised if the program's time runs out during an SDK call.

    It derives from BaseException, so that `except Exception` does not catch it.
    """


class CallClock:
    """Limit on the processor time that SDK calls of one thread take.

    The time of other threads and processes does not count, so a busy machine makes no program fail.
    """

    def __init__(self) -> None:
        self._thread = threading.get_ident()
        self._lock = threading.Lock()
        self._end: float | None = None
        """Processor time [s] of the thread at which the current call ends."""
        self._interrupted = False
        self._closed = threading.Event()
        self._worker: tuple[int, float, float] | None = None
        """Process id, processor time [s] when watching began, and time limit [s]."""
        self.worker_s: float | None = None
        """Processor time [s] of the worker at the last poll; None if the system reports none."""
        self.worker_killed = False

    def watch_worker(self, pid: int | None, limit_s: float = float("inf")) -> None:
        """Count the processor time of a worker from now on, and kill the worker at the limit."""
        used = None if pid is None else process_time(pid)
        if pid is not None and used is not None:
            self._worker, self.worker_s = (pid, used, limit_s), 0.0

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Watch SDK calls and the worker until the block ends."""
        watcher = threading.Thread(target=self._watch, name="call clock", daemon=True)
        watcher.start()
        try:
            yield
        finally:
            self._closed.set()
            watcher.join()

    @contextmanager
    def limited(self, seconds: float) -> Iterator[None]:
        """Raise CallInterrupted in the block when the block exceeds this processor time [s]."""
        if threading.get_ident() != self._thread or seconds == float("inf"):
            yield
            return
        with self._lock:
            self._end = time.thread_time() + max(seconds, 0.0)
        try:
            yield
        finally:
            with self._lock:
                self._end = None
                if self._interrupted:
                    self._raise(None)  # Cancel the exception, because the block has ended.

    def _watch(self) -> None:
        clock = time.pthread_getcpuclockid(self._thread)
        while not self._closed.wait(_POLL_S):
            self._read_worker()
            with self._lock:
                if self._end is not None and time.clock_gettime(clock) > self._end:
                    self._end = time.clock_gettime(clock) + _REPEAT_S
                    self._raise(CallInterrupted)

    def _read_worker(self) -> None:
        if self._worker is None:
            return
        pid, start_s, limit = self._worker
        used = process_time(pid)
        if used is not None:
            self.worker_s = used - start_s
            if self.worker_s > limit:
                self._worker, self.worker_killed = None, True
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)

    def _raise(self, kind: type[BaseException] | None) -> None:
        """Raise an exception in the watched thread; if None, cancel a pending exception."""
        self._interrupted = kind is not None
        raised = None if kind is None else ctypes.py_object(kind)
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread), raised)


def process_time(pid: int) -> float | None:
    """Return the processor time of a process [s]; None if the system does not report it."""
    try:
        # The name in parentheses may contain spaces. User and system time are fields 14 and 15.
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return None

"""Ctrl-C: repeat it if Python drops it, and end the process if native code delays it too long."""

import _thread
import contextlib
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

INTERRUPTED = 130
"""Exit code of a command that Ctrl-C ended."""
MESSAGE = "interrupted; continue with --resume"
GRACE_S = 1.0
"""Time after Ctrl-C in which a command may end by itself [s]. After this time, the process ends at
once, as if it were killed; a run folder survives this."""


@contextlib.contextmanager
def prompt_interrupts(report: Callable[[], object] | None) -> Iterator[None]:
    """End the process, with exit code 130, if a Ctrl-C does not end the block within `GRACE_S`.

    Python handles a signal only between Python instructions, and therefore not while XLA compiles
    or while an executor waits for its threads. Python also drops the exception if it occurs in a
    destructor or in JAX's callback of the garbage collector.

    Args:
        report: called before the process ends. If None, the block may take any time.
    """
    with _repeated_interrupts():
        if report is None or threading.current_thread() is not threading.main_thread():
            yield
            return
        signalled, ended = threading.Event(), threading.Event()
        signals, wakeup = socket.socketpair()
        wakeup.setblocking(False)

        def watch() -> None:
            while numbers := signals.recv(64):
                if signal.SIGINT in numbers:
                    signalled.set()
                    if not ended.wait(GRACE_S):
                        report()
                        os._exit(INTERRUPTED)

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        previous = signal.set_wakeup_fd(wakeup.fileno(), warn_on_full_buffer=False)
        try:
            yield
        except Exception as error:
            # An extension module (such as USD's) may replace the exception during its import.
            if signalled.wait(0.05):
                raise KeyboardInterrupt from error
            raise
        finally:
            ended.set()
            signal.set_wakeup_fd(previous)
            wakeup.close()
            watcher.join()
            signals.close()


@contextlib.contextmanager
def _repeated_interrupts() -> Iterator[None]:
    """Repeat a Ctrl-C that Python or native code drops.

    Python drops it in destructors and in JAX's callback of the garbage collector. Native code may
    print the exception and continue.
    """
    hooks, timers = (sys.unraisablehook, sys.excepthook), list[threading.Timer]()

    def repeated(kind: type[BaseException]) -> bool:
        if not issubclass(kind, KeyboardInterrupt):
            return False
        # Repeat it later, because the callback is still running.
        timers.append(threading.Timer(0.02, _thread.interrupt_main))
        timers[-1].start()
        return True

    def ignored(args: Any) -> None:
        if not repeated(args.exc_type):
            hooks[0](args)

    def printed(kind: type[BaseException], *rest: Any) -> None:
        if not repeated(kind):
            hooks[1](kind, *rest)

    sys.unraisablehook, sys.excepthook = ignored, printed
    try:
        yield
    finally:
        sys.unraisablehook, sys.excepthook = hooks
        for timer in timers:
            timer.cancel()

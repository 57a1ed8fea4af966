"""Output of commands in a terminal: log, status line and details; and Ctrl-C."""

import contextlib
import logging
import math
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import yaml
from rich.console import Console
from rich.live import Live
from rich.text import Text

from ..io.names import printable
from ..io.text_files import strict_json
from ..progress import LOGGER
from ..quantities import count

GRACE_S = 1.0
"""Time after Ctrl-C in which a command may end by itself [s]. After this time, the process ends at
once, as if it were killed; a run folder survives this."""


class _TolerantConsole(Console):
    """Console that ignores a closed stream instead of ending the process."""

    def on_broken_pipe(self) -> None:
        """Continue without output."""


class StatusLine(logging.Handler):
    """Logging handler that prints records and, in a terminal, shows the progress below them.

    Records of the progress logger update the status line; they are printed only if `verbose`.

    Args:
        stream: stream to which lines are printed, usually stderr.
        verbose: if True, also print progress records.
        quiet: if True, print only errors, and show no status line.
    """

    def __init__(
        self,
        stream: Any,
        *,
        verbose: bool = False,
        quiet: bool = False,
    ) -> None:
        super().__init__(logging.DEBUG)
        self._stream, self._verbose, self._quiet = stream, verbose, quiet
        self._facts: dict[str, Any] = {}
        self._step_start = time.monotonic()
        self._console = _TolerantConsole(file=stream, soft_wrap=True)
        self._live = Live(
            console=self._console,
            get_renderable=lambda: Text(printable(self.text()), no_wrap=True, overflow="ellipsis"),
            transient=True,
            refresh_per_second=2.0,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def __enter__(self) -> "StatusLine":
        """Show the status line."""
        if self._console.is_terminal and not self._quiet:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the status line."""
        with contextlib.suppress(OSError, ValueError):
            self._live.stop()

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record, or update the status line from it."""
        facts = getattr(record, "facts", None)
        if facts is not None:
            if facts.get("step", self._facts.get("step")) != self._facts.get("step"):
                self._step_start = time.monotonic()
                for name in ("done", "of", "unit", "rate", "left_s"):
                    self._facts.pop(name, None)
            self._facts.update(facts)
        if not self._shows(record):
            return
        text = printable(self.format(record))
        with contextlib.suppress(OSError, ValueError):  # The stream may be closed.
            if self._live.is_started:
                self._console.print(Text(text))
            else:
                self._stream.write(text + "\n")
                self._stream.flush()

    @property
    def unanswered(self) -> int:
        """Number of requests that models have not answered yet."""
        return self._facts.get("unanswered") or 0

    def text(self) -> str:
        """Return the status line."""
        facts = self._facts
        if not facts.get("step"):
            return ""
        parts = [f"{facts['step']} {time.monotonic() - self._step_start:.0f} s"]
        if facts.get("of"):
            parts.append(f"{facts.get('unit', 'part')} {facts.get('done', 0)} of {facts['of']}")
        if facts.get("rate"):
            parts.append(f"{facts['rate']:.0f} candidates/s")
        if facts.get("left_s") is not None:
            parts.append(f"about {facts['left_s']:.0f} s left")
        if facts.get("calls"):
            cost = facts.get("cost_usd")
            parts.append(count(facts["calls"], "call") + (f", {cost:.2f} USD" if cost else ""))
        waiting = facts.get("unanswered")
        parts.append(f"waiting for {count(waiting, 'response')}" if waiting else "computing")
        return " · ".join(parts)

    def _shows(self, record: logging.LogRecord) -> bool:
        if self._quiet:
            return record.levelno >= logging.ERROR
        if record.name == LOGGER and not self._verbose:
            return False
        return record.levelno >= logging.INFO


@contextlib.contextmanager
def prompt_interrupts(end: Callable[[], object] | None) -> Iterator[None]:
    """End the process if a Ctrl-C does not end the block within `GRACE_S`.

    Python handles a signal only between Python instructions, and therefore not while XLA compiles,
    and drops the exception if it occurs in a destructor.

    Args:
        end: function that ends the process. If None, the block may take any time.
    """
    if end is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    ended = threading.Event()
    signals, wakeup = socket.socketpair()
    wakeup.setblocking(False)

    def watch() -> None:
        while numbers := signals.recv(64):
            if signal.SIGINT in numbers and not ended.wait(GRACE_S):
                end()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    previous = signal.set_wakeup_fd(wakeup.fileno(), warn_on_full_buffer=False)
    try:
        yield
    finally:
        ended.set()
        signal.set_wakeup_fd(previous)
        wakeup.close()
        watcher.join()
        signals.close()


def details(result: Mapping[str, Any]) -> str:
    """Return all entries of a result as YAML."""
    options: dict[str, Any] = {"sort_keys": False, "allow_unicode": True, "width": math.inf}
    return yaml.safe_dump(strict_json(result), default_flow_style=None, **options).rstrip()

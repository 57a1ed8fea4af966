"""Output of commands in a terminal: log, status line and details; and Ctrl-C."""

import contextlib
import logging
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.table import Column, Table
from rich.text import Text

from ..io.names import printable
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
        live: if True, show the status line. If None, show it if the stream is a terminal.
    """

    def __init__(
        self,
        stream: Any,
        *,
        verbose: bool = False,
        quiet: bool = False,
        live: bool | None = None,
    ) -> None:
        super().__init__(logging.DEBUG)
        self._stream, self._verbose, self._quiet = stream, verbose, quiet
        self._facts: dict[str, Any] = {}
        self._step_start = time.monotonic()
        self._console = _TolerantConsole(file=stream, force_terminal=live, soft_wrap=True)
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


def details(result: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """Yield lines that show all entries of a result; lists of objects become tables."""
    for key, value in result.items():
        if isinstance(value, Mapping):
            yield f"{indent}{key}:"
            yield from details(value, indent + "  ")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            yield f"{indent}{key}:"
            yield from (f"{indent}  {line}" for line in _table(value))
        else:
            yield f"{indent}{key}: {_plain(value)}"


def _table(rows: list[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a table with a column for each key."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    table = Table(
        *(Column(Text(name)) for name in columns), box=None, padding=(0, 2, 0, 0), pad_edge=False
    )
    for row in rows:
        table.add_row(*(Text(_plain(row[name]) if name in row else "") for name in columns))
    console = Console(width=10_000, color_system=None)
    with console.capture() as capture:
        console.print(table)
    return [line.rstrip() for line in capture.get().splitlines()]


def _plain(value: Any) -> str:
    """Format a value as text. Hidden characters are escaped later, when the text is printed."""
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value)) or "none"
    if isinstance(value, float):
        return f"{value:.5g}"
    if value is None or isinstance(value, bool):
        return {None: "unknown", True: "yes", False: "no"}[value]
    return str(value)

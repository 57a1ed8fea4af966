"""Log on stderr, with a status line below it while a command runs in a terminal.

Without a terminal, the status line is printed after 30 seconds without output.
"""

import logging
import threading
import time
from contextlib import suppress
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from ..io.names import printable
from ..progress import LOGGER
from .result_lines import count

REFRESHES_PER_SECOND = 2.0
SILENT_S = 30.0
"""Time without output after which the status line is printed if there is no terminal [s]."""


class TolerantConsole(Console):
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
        silent_s: time without output after which the status line is printed if there is no terminal
            [s].
    """

    def __init__(
        self,
        stream: Any,
        *,
        verbose: bool = False,
        quiet: bool = False,
        live: bool | None = None,
        silent_s: float = SILENT_S,
    ) -> None:
        super().__init__(logging.DEBUG)
        self._stream, self._verbose, self._quiet = stream, verbose, quiet
        self._facts: dict[str, Any] = {}
        self._step_start = self._last_line = time.monotonic()
        self._silent_s, self._ended = silent_s, threading.Event()
        self._console = TolerantConsole(file=stream, force_terminal=live, soft_wrap=True)
        self._live = Live(
            console=self._console,
            get_renderable=lambda: Text(printable(self.text()), no_wrap=True, overflow="ellipsis"),
            transient=True,
            refresh_per_second=REFRESHES_PER_SECOND,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def __enter__(self) -> "StatusLine":
        """Show the status line."""
        if self._quiet:
            return self
        if self._console.is_terminal:
            self._live.start()
        else:
            threading.Thread(target=self._report, name="neoworld-status", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the status line."""
        self._ended.set()
        with suppress(OSError, ValueError):
            self._live.stop()
        self._facts.clear()

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record, or update the status line from it."""
        facts = getattr(record, "facts", None)
        if facts is not None:
            if facts.get("step", self._facts.get("step")) != self._facts.get("step"):
                self._step_start = time.monotonic()
                for name in ("done", "of", "unit", "rate", "left_s"):
                    self._facts.pop(name, None)
            self._facts.update(facts)
        if self._shows(record):
            self._print(printable(self.format(record)))

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
            parts.append(f"{facts['calls']} calls" + (f", {cost:.2f} USD" if cost else ""))
        waiting = facts.get("unanswered")
        parts.append(f"waiting for {count(waiting, 'response')}" if waiting else "computing")
        return " · ".join(parts)

    def _print(self, text: str) -> None:
        self._last_line = time.monotonic()
        with suppress(OSError, ValueError):  # The stream may be closed.
            if self._live.is_started:
                self._console.print(Text(text))
            else:
                self._stream.write(text + "\n")
                self._stream.flush()

    def _report(self) -> None:
        """Print the status line whenever no line was printed for `silent_s`."""
        while not self._ended.wait(max(self._last_line + self._silent_s - time.monotonic(), 0.01)):
            if time.monotonic() - self._last_line >= self._silent_s:
                text = printable(self.text())
                if text:
                    self._print(text)
                else:
                    self._last_line = time.monotonic()

    def _shows(self, record: logging.LogRecord) -> bool:
        if self._quiet:
            return record.levelno >= logging.ERROR
        if record.name == LOGGER and not self._verbose:
            return False
        return record.levelno >= logging.INFO

"""The status line at the bottom of a terminal while a command works, and its log above it."""

import logging
import shutil
import threading
import time
from types import TracebackType
from typing import Any

from ..io.names import printable
from ..progress import LOGGER

REFRESH_S = 0.5
_CLEAR = "\r\x1b[2K"


class PrintableFormatter(logging.Formatter):
    """Writes what hides or moves text on a terminal as escapes; names may come from strangers."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as a line; several lines stay several."""
        return printable(super().format(record))


class StatusLine(logging.Handler):
    """Writes the package's log as lines, and on a terminal the state of the work below them.

    Lines of progress are written where all details are asked for; else the status line alone shows
    progress, and what is no terminal gets none.

    Args:
        stream: usually stderr.
        verbose: write lines of progress, too.
        quiet: write errors alone.
        live: draw the status line; by default where the stream is a terminal.
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
        self.setFormatter(PrintableFormatter("%(message)s"))
        self._stream, self._verbose, self._quiet = stream, verbose, quiet
        self._live = (stream.isatty() if live is None else live) and not quiet
        self._facts: dict[str, Any] = {}
        self._since = time.monotonic()
        self._drawn = False
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> "StatusLine":
        """Begin to draw."""
        if self._live:
            self._thread = threading.Thread(target=self._redraw, daemon=True, name="status-line")
            self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take the status line away."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
        with self.lock or threading.RLock():
            self._clear()
            self._facts.clear()

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, or change the facts."""
        facts = getattr(record, "facts", None)
        if facts is not None:
            self._enter(facts)
        if not self._shows(record):
            return
        try:
            self._clear()
            self._stream.write(self.format(record) + "\n")
            self._stream.flush()
        except (OSError, ValueError):
            return  # Who reads has gone away; the work goes on.

    def text(self) -> str:
        """Return the status line."""
        f = self._facts
        if not f.get("step"):
            return ""
        said = [f"{f['step']} {time.monotonic() - self._since:.0f} s"]
        if f.get("of"):
            said.append(f"{f.get('unit', 'part')} {f.get('done', 0)} of {f['of']}")
        if f.get("rate"):
            said.append(f"{f['rate']:.0f} candidates/s")
        if f.get("left_s") is not None:
            said.append(f"about {f['left_s']:.0f} s left")
        if f.get("calls"):
            cost = f.get("cost_usd")
            said.append(f"{f['calls']} calls" + (f", {cost:.2f} USD" if cost else ""))
        said.append(f"waits for {f['unanswered']} answers" if f.get("unanswered") else "computes")
        return " · ".join(said)

    def _shows(self, record: logging.LogRecord) -> bool:
        if self._quiet:
            return record.levelno >= logging.ERROR
        if record.name == LOGGER:
            return self._verbose and record.levelno >= logging.INFO
        return record.levelno >= logging.INFO

    def _enter(self, facts: dict[str, Any]) -> None:
        if "step" in facts and facts["step"] != self._facts.get("step"):
            self._since = time.monotonic()
            for name in ("done", "of", "unit", "rate", "left_s"):
                self._facts.pop(name, None)
        self._facts.update(facts)

    def _redraw(self) -> None:
        while not self._ended.wait(REFRESH_S):
            with self.lock or threading.RLock():
                width = shutil.get_terminal_size().columns - 1
                text = printable(self.text())[:width]
                try:
                    self._stream.write(_CLEAR + text)
                    self._stream.flush()
                except (OSError, ValueError):
                    return
                self._drawn = bool(text)

    def _clear(self) -> None:
        if self._drawn:
            self._stream.write(_CLEAR)
            self._stream.flush()
            self._drawn = False

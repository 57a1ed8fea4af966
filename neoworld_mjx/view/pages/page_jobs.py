"""Long work of a page: one job at a time, its log and its error shown in words."""

import logging
import threading
from collections.abc import Callable
from typing import Any

from ...errors import NeoWorldError
from .page_html import told

Tell = Callable[[str], None]
"""Shows one line of text on the page."""


def work(busy: threading.Lock, shown: Any, job: Callable[[Tell], None]) -> None:
    """Do a job unless another one is going on; show the lines of its log, and its error.

    Args:
        busy: held while a job is done.
        shown: element of the page that shows text.
        job: called with what shows a line.
    """
    tell = lambda line: setattr(shown, "content", told(line))
    if not busy.acquire(blocking=False):
        tell("Still at work on what was asked before.")
        return
    page = _PageLog(tell)
    package = logging.getLogger("neoworld_mjx")
    package.addHandler(page)
    try:
        job(tell)
    except NeoWorldError as error:
        shown.content = told(str(error), bad=True)
    finally:
        package.removeHandler(page)
        busy.release()


class _PageLog(logging.Handler):
    """Shows the last line of the package's log."""

    def __init__(self, tell: Tell):
        super().__init__(logging.INFO)
        self._tell = tell

    def emit(self, record: logging.LogRecord) -> None:
        self._tell(record.getMessage())

"""Long jobs of a page, which run one at a time.

The page shows the last log line of a job or, if the job fails, the error.
"""

import logging
import threading
from collections.abc import Callable
from typing import Any

from ...errors import NeoWorldError
from .page_html import message

ShowLine = Callable[[str], None]
"""Function that shows a line of text on the page."""


def run_job(busy: threading.Lock, element: Any, job: Callable[[ShowLine], None]) -> None:
    """Run a job unless another job is running.

    Args:
        busy: lock that is held while a job runs.
        element: text element of the page, which shows the log and the error of the job.
        job: function that runs the job; it receives a function that shows a line of text.
    """

    def show_line(line: str) -> None:
        element.content = message(line)

    if not busy.acquire(blocking=False):
        show_line("Another job is still running.")
        return
    page = _PageLog(show_line)
    package = logging.getLogger("neoworld_mjx")
    package.addHandler(page)
    try:
        job(show_line)
    except NeoWorldError as error:
        element.content = message(str(error), bad=True)
    finally:
        package.removeHandler(page)
        busy.release()


class _PageLog(logging.Handler):
    """Log handler that shows the last line of the package's log."""

    def __init__(self, show_line: ShowLine):
        super().__init__(logging.INFO)
        self._show_line = show_line

    def emit(self, record: logging.LogRecord) -> None:
        self._show_line(record.getMessage())

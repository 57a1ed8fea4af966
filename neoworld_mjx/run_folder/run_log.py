"""run.log of a run folder: the package's log, with timestamps, while the folder is open."""

import errno
import logging
import os
import stat
from pathlib import Path

from ..io.names import printable

RUN_LOG = "run.log"
PACKAGE = "neoworld_mjx"
_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


class RunLog(logging.Handler):
    """Log handler that appends the package's log to run.log until it is closed.

    The level of the package's logger applies. On the command line, the log contains progress and
    warnings. In a program that sets no level, it contains only warnings. A log that cannot be
    written does not stop the run.
    """

    def __init__(self, folder: Path) -> None:
        """Open the log of a run folder.

        Raises:
            OSError: the log cannot be opened, or is a link.
        """
        super().__init__(logging.INFO)
        self.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        self._descriptor: int | None = os.open(folder / RUN_LOG, _FLAGS, 0o666)
        status = os.fstat(self._descriptor)
        if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
            self.close()
            raise OSError(
                errno.EMLINK, "run.log is not a regular file of this folder", str(folder / RUN_LOG)
            )
        logging.getLogger(PACKAGE).addHandler(self)

    def note(self, level: int, text: str) -> None:
        """Append a line to run.log only, not to other handlers of the log."""
        self.handle(logging.LogRecord(PACKAGE, level, "", 0, text, None, None))

    def emit(self, record: logging.LogRecord) -> None:
        """Append a record as one line."""
        if self._descriptor is None or record.levelno < self.level:
            return
        line = printable(self.format(record).replace("\n", " | ")) + "\n"
        try:
            os.write(self._descriptor, line.encode("utf-8", "replace"))
        except OSError:
            return

    def close(self) -> None:
        """Close the log."""
        logging.getLogger(PACKAGE).removeHandler(self)
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
        super().close()

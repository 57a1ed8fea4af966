"""The file run.log of a run folder: what the package logged while the run was open, with times."""

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
    """Appends the package's log to run.log until it is closed.

    It holds what the package's logger lets through: progress and warnings under the command line,
    warnings alone in a program that sets no level. A log that cannot be written ends no run.
    """

    def __init__(self, folder: Path) -> None:
        """Open the log of a run folder.

        Raises:
            OSError: it cannot be opened, or is no file of the folder's own.
        """
        super().__init__(logging.INFO)
        self.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        self._handle: int | None = os.open(folder / RUN_LOG, _FLAGS, 0o666)
        status = os.fstat(self._handle)
        if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
            self.close()
            raise OSError(
                errno.EMLINK, "run.log is no file of the folder's own", str(folder / RUN_LOG)
            )
        logging.getLogger(PACKAGE).addHandler(self)

    def note(self, level: int, text: str) -> None:
        """Append a line that only the file gets."""
        self.handle(logging.LogRecord(PACKAGE, level, "", 0, text, None, None))

    def emit(self, record: logging.LogRecord) -> None:
        """Append one line."""
        if self._handle is None or record.levelno < self.level:
            return
        line = printable(self.format(record).replace("\n", " | ")) + "\n"
        try:
            os.write(self._handle, line.encode("utf-8", "replace"))
        except OSError:
            return

    def close(self) -> None:
        """End the log."""
        logging.getLogger(PACKAGE).removeHandler(self)
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None
        super().close()

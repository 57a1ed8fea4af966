"""Progress of long computations, as log records with a message and facts for a status line.

Computations call `report` and `update`; a handler of the logger `neoworld_mjx.progress` shows the
records.
"""

import logging
from typing import Any

LOGGER = "neoworld_mjx.progress"
_log = logging.getLogger(LOGGER)


def report(line: str, **facts: Any) -> None:
    """Log a message, and update facts; see `update`."""
    _log.info("%s", line, extra={"facts": facts})


def update(**facts: Any) -> None:
    """Update facts of the status line without a message; None removes a fact.

    Args:
        facts: values by name: `step`; `done` and `of`, the progress in `unit`s; `rate`
            [candidates/s]; `left_s`; `calls`, `cost_usd` and `unanswered` calls of models.
    """
    _log.debug("", extra={"facts": facts})

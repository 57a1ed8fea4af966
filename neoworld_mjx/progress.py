"""Progress of long computations, as log records with a message and facts for a status line.

Computations call `report` and `update`; a handler of the logger `neoworld_mjx.progress` shows the
records.
"""

import logging
from typing import Any

LOGGER = "neoworld_mjx.progress"
_log = logging.getLogger(LOGGER)


def report(line: str, **facts: Any) -> None:
    """Log a message, and update the facts of the status line; see `update`."""
    _log.info("%s", line, extra={"facts": facts})


def update(**facts: Any) -> None:
    """Update facts of the status line without a message; None removes a fact.

    Args:
        facts: values by name. `step` is the name of the step. `done`, `of` and `unit` give the
            progress, such as 3 of 10 iterations. `rate` is a number of candidates per second, and
            `left_s` the remaining time [s]. `calls` and `cost_usd` are the number and cost of
            the calls of models, and `unanswered` is the number of calls without a response yet.
    """
    _log.debug("", extra={"facts": facts})

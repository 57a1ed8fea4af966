"""Progress of long work, as records of the log: a line for people, and facts for a status line.

Whoever works calls `report` and `update`; who shows it handles the records of the logger
`neoworld_mjx.progress`. So no layer knows how progress is shown, or whether it is.
"""

import logging
from typing import Any

LOGGER = "neoworld_mjx.progress"
_log = logging.getLogger(LOGGER)


def report(line: str, **facts: Any) -> None:
    """Report a line, and facts that hold from now on; see `update`."""
    _log.info("%s", line, extra={"facts": facts})


def update(**facts: Any) -> None:
    """Change facts of the status line without a line of their own; None takes a fact away.

    Args:
        facts: by name: `step`; `done` and `of`, how much of it is done, in `unit`s; `rate`
            [candidates/s]; `left_s`; `calls`, `cost_usd` and `unanswered` calls of models.
    """
    _log.debug("", extra={"facts": facts})

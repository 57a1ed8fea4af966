"""Build a program: run it in its sandbox, then check the object that it made."""

import time
from dataclasses import replace

from ..config import ProgramOptions
from .check import check
from .sandbox import Built, run
from .signals import Signal, deduplicated


def build(text: str, options: ProgramOptions | None = None) -> Built:
    """Turn a program's text into a checked object.

    Args:
        text: the program.
        options: sandbox, limits and thresholds.

    Returns:
        The object with all signals; it never raises for anything that the program does. `spec` is
        None when the program failed, and `ok` tells whether the object passed every check.
    """
    options = options or ProgramOptions()
    made = run(text, options)
    if made.spec is None:
        return made
    start = time.monotonic()
    try:
        found = check(made.spec, options, made.lines, made.allowances)
    except Exception as error:  # the border: a fault of a check is a signal, too
        message = f"a check failed: {type(error).__name__}: {error}"[:500]
        found = (Signal(severity="error", code="internal", message=message),)
    seconds = made.seconds + time.monotonic() - start
    signals = deduplicated((*made.signals, *found))
    return replace(made, signals=signals, seconds=seconds)

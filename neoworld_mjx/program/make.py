"""Build a program: run it in its sandbox, then check the object that it made."""

import time
from dataclasses import replace

from ..checks.compile_checks import check
from ..checks.signals import Signal, deduplicated
from ..config import ProgramOptions
from .sandbox import Built, run


def build(text: str, options: ProgramOptions | None = None) -> Built:
    """Turn a program's text into a checked object; no program makes this raise.

    Args:
        text: the program.
        options: sandbox, limits and thresholds.

    Returns:
        The object with all signals. `spec` is None when the program failed, and `ok` tells whether
        the object passed every check.
    """
    options = options or ProgramOptions()
    built = run(text, options)
    if built.spec is None:
        return built
    start = time.monotonic()
    try:
        findings = check(built.spec, options, built.lines, built.allowances)
    except Exception as error:  # A check that fails itself is a signal, too.
        message = f"a check failed: {type(error).__name__}: {error}"[:500]
        findings = (Signal(severity="error", code="internal", message=message),)
    seconds = built.seconds + time.monotonic() - start
    signals = deduplicated((*built.signals, *findings))
    return replace(built, signals=signals, seconds=seconds)

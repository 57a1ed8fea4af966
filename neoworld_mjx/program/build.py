"""Build a program: run it in its sandbox, then check the object that it made."""

from ..config import ProgramOptions
from .sandbox import Built, run


def build(text: str, options: ProgramOptions | None = None) -> Built:
    """Turn a program's text into a checked object.

    Args:
        text: the program.
        options: sandbox, limits and thresholds.

    Returns:
        The object with all signals; it never raises for anything that the program does. `spec` is
        None when the program failed, and `ok` tells whether the object passed every check.
    """
    return run(text, options)

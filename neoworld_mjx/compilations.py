"""Counting and timing what JAX compiles."""

from typing import NamedTuple

import jax.monitoring

_PREFIX = "/jax/core/compile/"
_PROGRAM = _PREFIX + "backend_compile_duration"


class Compiled(NamedTuple):
    """What JAX has compiled since the first call of `compiled`."""

    programs: int = 0
    """Programs built, or read from the cache."""
    seconds: float = 0.0
    """Time of tracing, lowering and compiling them [s]."""


class _Count:
    so_far = Compiled()
    listening = False


def compiled() -> Compiled:
    """Return the programs that JAX has built or read from a cache since the first call."""
    if not _Count.listening:
        _Count.listening = True
        jax.monitoring.register_event_duration_secs_listener(_heard)
    return _Count.so_far


def compilations() -> int:
    """Count the programs that JAX has built or read from a cache since the first call."""
    return compiled().programs


def _heard(event: str, duration_secs: float, **_: str | int) -> None:
    if event.startswith(_PREFIX):
        programs, seconds = _Count.so_far
        _Count.so_far = Compiled(programs + (event == _PROGRAM), seconds + duration_secs)

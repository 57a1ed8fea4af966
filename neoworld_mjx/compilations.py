"""Number and time of JAX compilations."""

from typing import NamedTuple

import jax.monitoring

_PREFIX = "/jax/core/compile/"
_PROGRAM = _PREFIX + "backend_compile_duration"


class Compiled(NamedTuple):
    """Compilations since the first call of `compiled`."""

    programs: int = 0
    """Programs compiled, or read from the cache."""
    seconds: float = 0.0
    """Time of tracing, lowering and compiling them [s]."""


class _Count:
    so_far = Compiled()
    listening = False


def compiled() -> Compiled:
    """Return the compilations, and reads from a cache, since the first call."""
    if not _Count.listening:
        _Count.listening = True
        jax.monitoring.register_event_duration_secs_listener(_on_event)
    return _Count.so_far


def compilations() -> int:
    """Return the number of programs compiled, or read from a cache, since the first call."""
    return compiled().programs


def _on_event(event: str, duration_secs: float, **_: str | int) -> None:
    if event.startswith(_PREFIX):
        programs, seconds = _Count.so_far
        _Count.so_far = Compiled(programs + (event == _PROGRAM), seconds + duration_secs)

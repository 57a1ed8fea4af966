"""Number and time of JAX compilations."""

from typing import NamedTuple

import jax.monitoring

_PREFIX = "/jax/core/compile/"
_PROGRAM = _PREFIX + "backend_compile_duration"


class Compiled(NamedTuple):
    """Compilations since the first call of `compiled`."""

    programs: int = 0
    """Number of functions that were compiled or read from the cache."""
    seconds: float = 0.0
    """Time spent on tracing, lowering and compiling [s]."""


class _Count:
    so_far = Compiled()
    listening = False


def compiled() -> Compiled:
    """Return the number and time of compilations since the first call, which starts counting."""
    if not _Count.listening:
        _Count.listening = True
        jax.monitoring.register_event_duration_secs_listener(_on_event)
    return _Count.so_far


def compilations() -> int:
    """Return the number of functions compiled, or read from the cache; see `compiled`."""
    return compiled().programs


def _on_event(event: str, duration_secs: float, **_: str | int) -> None:
    if event.startswith(_PREFIX):
        programs, seconds = _Count.so_far
        _Count.so_far = Compiled(programs + (event == _PROGRAM), seconds + duration_secs)

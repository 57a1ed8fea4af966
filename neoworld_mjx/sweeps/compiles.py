"""Counting what JAX compiles."""

import jax.monitoring

_EVENT = "/jax/core/compile/backend_compile_duration"


class _Count:
    total = 0
    listening = False


def compilations() -> int:
    """Count the programs that JAX has built or read from a cache since the first call."""
    if not _Count.listening:
        _Count.listening = True
        jax.monitoring.register_event_duration_secs_listener(_heard)
    return _Count.total


def _heard(event: str, duration_secs: float, **_: str | int) -> None:
    del duration_secs
    if event == _EVENT:
        _Count.total += 1

"""The cache folder, JAX's compilation caches, and the number and time of compilations."""

import os
from pathlib import Path
from typing import NamedTuple

import jax.monitoring

from .errors import EngineError

VARIABLE = "NEOWORLD_CACHE"


def cache_folder() -> Path:
    """Return $NEOWORLD_CACHE or, if it is unset, `neoworld` in the user's cache folder.

    The folder may not exist.
    """
    if os.environ.get(VARIABLE):
        return Path(os.environ[VARIABLE])
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "neoworld"


def check_jax() -> None:
    """Check that JAX has a device and computes in single precision.

    Raises:
        EngineError: JAX cannot start, or the environment asks for double precision.
    """
    import jax

    try:
        jax.devices()
    except Exception as error:  # An AssertionError without text, among others.
        reason = str(error).partition("\n")[0] or "it finds no such device"
        platforms = os.environ.get("JAX_PLATFORMS", "")
        raise EngineError(
            f"JAX cannot start with JAX_PLATFORMS={platforms!r} ({reason}); unset it, or install "
            "the extra cuda for an NVIDIA GPU"
        ) from None
    if jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise EngineError(
            "JAX is set to double precision (JAX_ENABLE_X64), but batches are simulated in single "
            "precision; unset it"
        )


def keep_compilations() -> Path | None:
    """Check JAX, and enable its persistent compilation cache unless it already has a cache folder.

    Returns:
        The cache folder, or None if the folder is not writable. Without a cache, every process
        compiles its functions again.

    Raises:
        EngineError: as in `check_jax`.
    """
    import jax

    check_jax()
    chosen = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    folder = Path(chosen) if chosen else cache_folder() / "jax"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    if not os.access(folder, os.W_OK):
        return None
    if not chosen:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    return folder


def free_memory_maps(share: float = 0.5) -> bool:
    """Clear JAX's caches if the process may run out of memory maps; return True if it cleared them.

    On CPUs, every compiled function maps about a hundred memory regions, and JAX keeps the compiled
    functions of past scenes. Linux allows 65 530 maps per process, so compilation would fail after
    about thirty scenes. The caches are cleared if the process uses at least the fraction `share` of
    the allowed maps. On systems that do not report memory maps, the caches are never cleared.
    """
    import jax

    try:
        with open("/proc/self/maps", "rb") as maps:
            used = sum(1 for _ in maps)
        allowed = int(Path("/proc/sys/vm/max_map_count").read_text(encoding="ascii"))
    except (OSError, ValueError):
        return False
    if used < share * allowed:
        return False
    jax.clear_caches()
    return True


def computes_on_cpu() -> bool:
    """Return True if JAX computes on the CPU, by default or because of `jax.default_device`."""
    import jax

    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    if chosen is None:
        return jax.default_backend() == "cpu"
    return (chosen if isinstance(chosen, str) else chosen.platform).startswith("cpu")


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


def _on_event(event: str, duration_secs: float, **_: str | int) -> None:
    if event.startswith(_PREFIX):
        programs, seconds = _Count.so_far
        _Count.so_far = Compiled(programs + (event == _PROGRAM), seconds + duration_secs)

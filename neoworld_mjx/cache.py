"""The folder of the cache of compiled programs and results."""

import os
from pathlib import Path

VARIABLE = "NEOWORLD_CACHE"


def cache_folder() -> Path:
    """Return $NEOWORLD_CACHE, else `neoworld` in the user's cache folder; it need not exist."""
    if os.environ.get(VARIABLE):
        return Path(os.environ[VARIABLE])
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "neoworld"


def keep_compilations() -> Path | None:
    """Let JAX keep what it compiles on disk; a folder that was set already is left alone.

    Returns:
        The folder in use; None if it cannot be written, which costs time only.
    """
    import jax

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


def make_room(share: float = 0.5) -> bool:
    """Drop what JAX has compiled before the process runs out of memory maps.

    On CPUs every program maps memory some hundred times, JAX keeps programs of scenes that are
    gone, and Linux allows 65 530 maps a process: after some thirty scenes compiling would fail.
    A program that is needed again is compiled again.

    Args:
        share: of the allowed maps from which programs are dropped.

    Returns:
        Whether they were; never where the system does not tell.
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

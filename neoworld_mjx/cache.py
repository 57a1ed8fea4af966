"""Cache folder of compiled programs and results, and bounds of JAX's caches."""

import os
from pathlib import Path

VARIABLE = "NEOWORLD_CACHE"


def cache_folder() -> Path:
    """Return $NEOWORLD_CACHE, or else `neoworld` in the user's cache folder; it may not exist."""
    if os.environ.get(VARIABLE):
        return Path(os.environ[VARIABLE])
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "neoworld"


def keep_compilations() -> Path | None:
    """Enable JAX's persistent compilation cache, unless its folder is already set.

    Returns:
        The folder; None if it cannot be written, which only costs time.
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


def free_memory_maps(share: float = 0.5) -> bool:
    """Clear JAX's caches before the process runs out of memory maps; return True if cleared.

    On CPUs every compiled program maps some hundred regions, JAX keeps the programs of past scenes,
    and Linux allows 65 530 maps per process: compilation would fail after some thirty scenes.
    Caches are cleared if the process uses more than `share` of the allowed maps. Systems that do
    not report their maps never clear caches.
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

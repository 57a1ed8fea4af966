"""Installation of Blender, and a test whether programs can run in a confined Blender process."""

import shutil
import subprocess
from functools import lru_cache
from pathlib import Path

from ...errors import ProgramError
from .blender_environment import INSTALL, LIBRARIES, blender_folder, blender_python, commands
from .blender_process import run_confined

_SECONDS = 1800.0
"""Time limit of an installation command [s]."""


def install_blender() -> Path:
    """Create or update Blender's virtual environment, and return the environment's folder.

    Raises:
        ProgramError: uv is missing, a command failed, or Blender cannot run programs.
    """
    lines = "\n".join(f"    {' '.join(command)}" for command in commands())
    if shutil.which("uv") is None:
        raise ProgramError(
            f"Blender is installed by uv, which is missing (pip install uv):\n{lines}"
        )
    blender_folder().parent.mkdir(parents=True, exist_ok=True)
    for command in commands():
        try:
            # In a clone of this package, uv would apply the package's pinned versions to bpy.
            process = subprocess.run(
                command,
                capture_output=True,
                text=True,
                timeout=_SECONDS,
                check=False,
                cwd=blender_folder().parent,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ProgramError(f"{' '.join(command)}: {error}") from None
        if process.returncode:
            output = process.stderr.strip()[-400:]
            raise ProgramError(f"{' '.join(command)} ended with {process.returncode}: {output}")
    _test_run.cache_clear()
    reason = unavailable()
    if reason is not None:
        raise ProgramError(reason)
    return blender_folder()


def require_blender() -> None:
    """Raise ProgramError if Blender is not installed, cannot be loaded or cannot be confined."""
    reason = unavailable()
    if reason is not None:
        raise ProgramError(f"program.language blender: {reason}; or use program.language sdk")


def unavailable() -> str | None:
    """Return why Blender cannot run programs on this machine, or None if it can.

    The test run is made once in a process.
    """
    if not blender_python().exists():
        return f"Blender is not installed ({blender_python()} is missing): run `{INSTALL}`"
    return _test_run(str(blender_python()))


@lru_cache(maxsize=1)
def _test_run(python: str) -> str | None:
    """Run an empty program; if it fails, return the reason."""
    output = run_confined("", timeout_s=60.0, memory_mib=4096)
    if output.missing:
        return f"untrusted programs cannot be confined here without {output.missing}"
    if output.exit_code:
        last = output.errors.strip().rpartition("\n")[2][:300]
        return f"{python} cannot load bpy: {last} (`{INSTALL}`; its libraries: {LIBRARIES})"
    return None

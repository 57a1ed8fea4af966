"""Installation of Blender, and the test that its programs can run confined on this machine."""

import shutil
import subprocess
from functools import lru_cache
from pathlib import Path

from ...errors import ProgramError
from .blender_environment import INSTALL, LIBRARIES, blender_folder, blender_python, commands
from .blender_process import blender_answer

_SECONDS = 1800.0
"""Time limit of an installation command."""


def install_blender() -> Path:
    """Create or update Blender's environment and return its folder.

    Raises:
        ProgramError: uv is missing, or a command failed.
    """
    lines = "\n".join(f"    {' '.join(command)}" for command in commands())
    if shutil.which("uv") is None:
        raise ProgramError(
            f"Blender is installed by uv, which is missing (pip install uv):\n{lines}"
        )
    blender_folder().parent.mkdir(parents=True, exist_ok=True)
    for command in commands():
        try:
            # In a clone of this package uv would apply the versions pinned there to bpy.
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
    """Return the reason why Blender's programs cannot run here, None if they can; tested once."""
    if not blender_python().exists():
        return f"Blender is not installed ({blender_python()} is missing): run `{INSTALL}`"
    return _test_run(str(blender_python()))


@lru_cache(maxsize=1)
def _test_run(python: str) -> str | None:
    """Run an empty program."""
    answer = blender_answer("", timeout_s=60.0, memory_mib=4096)
    if answer.missing:
        return f"untrusted programs cannot be confined here without {answer.missing}"
    if answer.exit_code:
        last = answer.errors.strip().rpartition("\n")[2][:300]
        return f"{python} cannot load bpy: {last} (`{INSTALL}`; its libraries: {LIBRARIES})"
    return None

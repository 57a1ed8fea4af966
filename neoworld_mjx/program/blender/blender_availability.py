"""Whether programs of Blender can run on this machine: installed, loaded, confined."""

import shutil
import subprocess
from functools import lru_cache
from pathlib import Path

from ...errors import ProgramError
from .blender_environment import INSTALL, LIBRARIES, blender_folder, blender_python, commands
from .blender_process import blender_answer

_SECONDS = 1800.0
"""Time for one of the commands that install it."""


def install_blender() -> Path:
    """Make the environment, or bring it up to date.

    Returns:
        Its folder.

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
            # In a clone of this package uv would hold bpy to the versions that are pinned there.
            done = subprocess.run(
                command,
                capture_output=True,
                text=True,
                timeout=_SECONDS,
                check=False,
                cwd=blender_folder().parent,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ProgramError(f"{' '.join(command)}: {error}") from None
        if done.returncode:
            told = done.stderr.strip()[-400:]
            raise ProgramError(f"{' '.join(command)} ended with {done.returncode}: {told}")
    _trial.cache_clear()
    why = unavailable()
    if why is not None:
        raise ProgramError(why)
    return blender_folder()


def require_blender() -> None:
    """Refuse to go on where programs of Blender cannot run.

    Raises:
        ProgramError: Blender is not installed, cannot be loaded, or cannot be confined here.
    """
    why = unavailable()
    if why is not None:
        raise ProgramError(f"program.language blender: {why}; or take program.language sdk")


def unavailable() -> str | None:
    """Return what programs of Blender lack on this machine, None if nothing; tried once."""
    if not blender_python().exists():
        return f"Blender is not installed ({blender_python()} is missing): run `{INSTALL}`"
    return _trial(str(blender_python()))


@lru_cache(maxsize=1)
def _trial(python: str) -> str | None:
    """Run an empty program."""
    answer = blender_answer("", timeout_s=60.0, memory_mib=4096)
    if answer.missing:
        return f"programs of strangers cannot be confined here without {answer.missing}"
    if answer.exit_code:
        last = answer.errors.strip().rpartition("\n")[2][:300]
        return f"{python} cannot load bpy: {last} (`{INSTALL}`; its libraries: {LIBRARIES})"
    return None

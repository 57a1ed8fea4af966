"""Blender: its environment, and the execution of programs in a confined process.

Blender is distributed as the package bpy. The package requires NumPy 1 and one version of CPython,
so it is installed into a separate virtual environment in the cache folder. The output of a process
is untrusted.
"""

import os
import subprocess
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from ...cache import cache_folder
from ...checks.signals import Signal, error_signal
from ...errors import ProgramError
from ...io import read_model
from ...io.files import MIB, read_bytes
from ...io.names import printable
from ..sandbox import ENDLESS_HINT, MAX_PRINTED_BYTES
from .blender_child import UNAVAILABLE
from .blender_scene import BlenderScene

BPY, PYTHON = "5.0.1", "3.11"
"""Versions of bpy and of CPython; this bpy is the latest for this CPython."""
LIBRARIES = "libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1"
"""Debian packages with libraries that bpy is linked to but does not contain."""


SCENE_MIB = 48
"""Largest size of the returned scene [MiB]; a triangle takes about 40 bytes."""
_WALL_TIME_FACTOR = 10.0
"""Limit on wall time, as a multiple of the limit on processor time; the machine may be busy."""
_CPU_START_S = 5
"""Additional processor time for loading Blender [s]."""
_CHILD = Path(__file__).with_name("blender_child.py")
_KILL_CODES = (-9, -24)
"""Exit codes of a process that exceeded the limit on processor time: SIGKILL and SIGXCPU."""


def blender_folder() -> Path:
    """Return the folder of Blender's virtual environment; the folder may not exist."""
    return cache_folder() / f"bpy-{BPY}"


def blender_python() -> Path:
    """Return the path of the Python interpreter that has bpy; the file may not exist."""
    return blender_folder() / "bin" / "python"


def install_commands() -> str:
    """Return the commands that create the environment: a download of 360 MB, 970 MB on disk."""
    return (
        f"uv venv --python {PYTHON} {blender_folder()} && "
        f"uv pip install --python {blender_python()} bpy=={BPY} 'numpy<2'"
    )


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
        return f"Blender is not installed ({blender_python()} is missing): run {install_commands()}"
    return _test_run(str(blender_python()))


@lru_cache(maxsize=1)
def _test_run(python: str) -> str | None:
    """Run an empty program; if it fails, return the reason."""
    output = run_confined("", timeout_s=60.0, memory_mib=4096)
    if output.missing:
        return f"untrusted programs cannot be confined here without {output.missing}"
    if output.exit_code:
        last = output.errors.strip().rpartition("\n")[2][:300]
        return f"{python} cannot load bpy: {last} (its libraries: {LIBRARIES})"
    return None


@dataclass(frozen=True)
class BlenderOutput:
    """Output of one run of Blender."""

    scene: BlenderScene | None
    """The scene; None if the run failed."""
    exit_code: int
    """Exit code as `subprocess` returns it; negative if a signal ended the process."""
    printed: str = ""
    errors: str = ""
    """Standard error."""
    timed_out: bool = False
    unreadable: str = ""
    """Why the scene of a successful program cannot be read; empty if it can be read."""

    @property
    def missing(self) -> str:
        """Kernel feature that confines the process but is missing on this machine; else empty."""
        if self.exit_code != UNAVAILABLE:
            return ""
        return self.errors.rpartition("missing: ")[2].strip() or "Landlock and seccomp"


def run_confined(text: str, *, timeout_s: float, memory_mib: int) -> BlenderOutput:
    """Run a program in a confined Blender process.

    Args:
        text: the program.
        timeout_s: limit on the program's processor time [s]. The limit on wall time is ten times
            the processor time, including the time for loading Blender.
        memory_mib: limit on the address space of the process [MiB], of which Blender takes about
            1300 MiB.
    """
    with tempfile.TemporaryDirectory(prefix="neoworld-blender-") as name:
        folder = Path(name)
        (folder / "program.py").write_text(text, encoding="utf-8")
        paths = [folder / file for file in ("program.py", "printed", "errors", "scene.json")]
        cpu_s = round(timeout_s) + _CPU_START_S
        with (
            paths[0].open("rb") as program,
            paths[1].open("wb") as printed,
            paths[2].open("wb") as errors,
            paths[3].open("wb") as scene_file,
        ):
            limits = (memory_mib, cpu_s, SCENE_MIB, scene_file.fileno())
            # The size of files is limited, and files, unlike pipes, need no reader.
            child = subprocess.Popen(
                [str(blender_python()), "-I", "-B", str(_CHILD), *map(str, limits)],
                stdin=program,
                stdout=printed,
                stderr=errors,
                pass_fds=(scene_file.fileno(),),
                cwd="/",
                env={"HOME": "/nonexistent", "PATH": "/nonexistent", "LANG": "C.UTF-8"},
                start_new_session=True,
            )
            try:
                code, timed_out = child.wait(_WALL_TIME_FACTOR * cpu_s), False
            except subprocess.TimeoutExpired:
                code, timed_out = 0, True
            finally:
                child.kill()
                child.wait()
        out, err = (_read(path, MAX_PRINTED_BYTES) for path in paths[1:3])
        if timed_out or code:
            return BlenderOutput(
                None, code or -9, out, err, timed_out=timed_out or code in _KILL_CODES
            )
        try:
            scene = read_model(paths[3], BlenderScene, ProgramError, "a scene of Blender")
        except ProgramError as error:
            reason = str(error).replace(str(paths[3]), "the scene")
            return BlenderOutput(None, 0, out, err, unreadable=reason)
        return BlenderOutput(scene, 0, out, err)


def _read(path: Path, limit: int) -> str:
    size = os.stat(path).st_size
    data = read_bytes(path, SCENE_MIB * MIB + 1)
    data = data if size <= limit else data[: limit // 2] + b"\n...\n" + data[-limit // 2 :]
    return printable(data.decode("utf-8", "replace"))


def failure(output: BlenderOutput, timeout_s: float) -> Signal:
    """Return the error signal of a program that produced no scene."""
    if output.timed_out:
        message = f"the program took over {timeout_s:g} s"
        return error_signal("timeout", message, hint=ENDLESS_HINT)
    if output.unreadable:
        message = f"the scene could not be read back: {output.unreadable}"[:400]
        return error_signal("too_big", message, hint="use fewer triangles")
    last = next((line for line in reversed(output.errors.splitlines()) if line.strip()), "")
    code = "memory" if "MemoryError" in output.errors or "bad_alloc" in output.errors else "crashed"
    message = f"Blender ended with {output.exit_code}: {last}"[:400]
    return error_signal(code, message, hint="the program must end by itself")

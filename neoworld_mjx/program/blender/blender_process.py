"""Run a program in Blender: a confined process with a clock, and its answer as untrusted data."""

import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from ...checks.signals import Signal
from ...errors import ProgramError
from ...io import read_model
from ...io.files import MIB, read_bytes
from ...io.names import printable
from ..exception_signals import ENDLESS_HINT
from .blender_answer import BlenderScene
from .blender_child import UNAVAILABLE
from .blender_environment import blender_python

ANSWER_MIB = 48
"""Largest answer; a triangle takes some 40 bytes."""
_WALL = 4.0
"""Wall time that a program has, in units of its processor time, as the machine may be busy."""
_CPU_START_S = 5
"""Processor time for loading Blender, which no program pays for."""
_CHILD = Path(__file__).with_name("blender_child.py")
_KILLED = (-9, -24)
"""Ends by the limit of processor time: SIGKILL, SIGXCPU."""


@dataclass(frozen=True)
class BlenderAnswer:
    """What a run of Blender left."""

    scene: BlenderScene | None
    exit_code: int
    """0, or why it ended, as of `subprocess`."""
    printed: str = ""
    errors: str = ""
    """What it wrote to standard error."""
    timed_out: bool = False
    unreadable: str = ""
    """Why there is no scene though the program ended well."""

    @property
    def missing(self) -> str:
        """Name what this machine lacks to confine the process; empty if nothing."""
        if self.exit_code != UNAVAILABLE:
            return ""
        return self.errors.rpartition("missing: ")[2].strip() or "Landlock and seccomp"


def blender_answer(
    text: str, *, timeout_s: float, memory_mib: int, printed_bytes: int = 20_000
) -> BlenderAnswer:
    """Run a text in Blender.

    Args:
        text: the program.
        timeout_s: processor time of the program [s]; it may take four times as long on the clock.
        memory_mib: address space of the process [MiB]; Blender itself takes some 1300.
        printed_bytes: how much of what it prints is kept.
    """
    with tempfile.TemporaryDirectory(prefix="neoworld-blender-") as name:
        folder = Path(name)
        (folder / "program.py").write_text(text, encoding="utf-8")
        paths = [folder / each for each in ("program.py", "printed", "errors", "answer.json")]
        cpu_s = round(timeout_s) + _CPU_START_S
        with (
            paths[0].open("rb") as program,
            paths[1].open("wb") as printed,
            paths[2].open("wb") as errors,
            paths[3].open("wb") as answer,
        ):
            limits = (memory_mib, cpu_s, ANSWER_MIB, answer.fileno())
            # Files, not pipes: what it may write into them is limited, and nobody waits for them.
            child = subprocess.Popen(
                [str(blender_python()), "-I", "-B", str(_CHILD), *map(str, limits)],
                stdin=program,
                stdout=printed,
                stderr=errors,
                pass_fds=(answer.fileno(),),
                cwd="/",
                env={"HOME": "/nonexistent", "PATH": "/nonexistent", "LANG": "C.UTF-8"},
                start_new_session=True,
            )
            try:
                code, late = child.wait(_WALL * cpu_s), False
            except subprocess.TimeoutExpired:
                code, late = 0, True
            finally:
                child.kill()
                child.wait()
        out, err = (_read(path, printed_bytes) for path in paths[1:3])
        if late or code:
            return BlenderAnswer(None, code or -9, out, err, timed_out=late or code in _KILLED)
        try:
            scene = read_model(paths[3], BlenderScene, ProgramError, "an answer of Blender")
        except ProgramError as error:
            why = str(error).replace(str(paths[3]), "the answer")
            return BlenderAnswer(None, 0, out, err, unreadable=why)
        return BlenderAnswer(scene, 0, out, err)


def _read(path: Path, most: int) -> str:
    size = os.stat(path).st_size
    data = read_bytes(path, ANSWER_MIB * MIB + 1)
    data = data if size <= most else data[: most // 2] + b"\n...\n" + data[-most // 2 :]
    return printable(data.decode("utf-8", "replace"))


def failure(answer: BlenderAnswer, timeout_s: float) -> Signal | None:
    """Return the error of a program that gave no scene, None if it gave one."""
    if answer.scene is not None:
        return None
    if answer.timed_out:
        message = f"the program took over {timeout_s:g} s"
        return Signal(severity="error", code="timeout", message=message, hint=ENDLESS_HINT)
    if answer.unreadable:
        message = f"the scene could not be read back: {answer.unreadable}"[:400]
        return Signal(severity="error", code="too_big", message=message, hint="use fewer triangles")
    last = next((line for line in reversed(answer.errors.splitlines()) if line.strip()), "")
    code = "memory" if "MemoryError" in answer.errors or "bad_alloc" in answer.errors else "crashed"
    message = f"Blender ended with {answer.exit_code}: {last}"[:400]
    return Signal(
        severity="error", code=code, message=message, hint="the program must end by itself"
    )

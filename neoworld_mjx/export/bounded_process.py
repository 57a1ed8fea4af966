"""Run a library on a file in a child process with bounded memory and time.

A few bytes of USD or lines of MJCF can make a library take all memory, run for hours or crash.
"""

import subprocess
import sys
from pathlib import Path

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB

MEMORY_MIB = 4096
_LIMITS = """
import resource, sys
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
resource.setrlimit(resource.RLIMIT_AS, ({0}, {0}))
"""


def run_bounded(
    path: Path, code: str, *arguments: str, library: str, verb: str, accepted: tuple[int, ...] = ()
) -> tuple[int, bytes]:
    """Run Python code in a child process and return its exit status and standard output.

    Args:
        path: the file that the code reads, for messages.
        code: the program, with its imports.
        arguments: its command-line arguments.
        library: name of the library that reads the file, for messages.
        verb: verb for the action of the library on the file, for messages.
        accepted: exit statuses other than 0 that the caller handles.

    Raises:
        SpecError: the process exceeds its time or memory, or crashes.
    """
    seconds = file_bounds().timeout_s
    try:
        done = subprocess.run(
            [sys.executable, "-c", _LIMITS.format(MEMORY_MIB * MIB) + code, *arguments],
            capture_output=True,
            check=False,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        raise SpecError(
            f"{path}: {library} takes over {seconds:g} s to {verb} it; make the file smaller, or "
            "raise files.timeout_s if you trust it"
        ) from None
    if done.returncode and done.returncode not in accepted:
        last = done.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
        reason = " ".join(last)[:200] or f"signal {-done.returncode}"
        raise SpecError(
            f"{path}: {library} cannot {verb} it within {MEMORY_MIB} MiB of memory, or crashes "
            f"({reason}); make the file smaller"
        )
    return done.returncode, done.stdout

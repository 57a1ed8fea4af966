"""Try in another process what a file makes MuJoCo do, before it is done in this one.

A few lines of MJCF can ask for grids, textures or sensors that no memory holds, or that take hours.
"""

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB

RISKY = {"flexcomp", "composite", "replicate", "user", "size", "hfield", "texture", "skin", "flex"}
"""Elements whose numbers decide how much is made of them."""
_MEMORY = 4096 * MIB
_CODE = """
import resource, sys, mujoco
most = int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_AS, (most, most))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
try:
    spec = mujoco.MjSpec.from_file(sys.argv[1])
    spec.compiler.discardvisual = spec.compiler.fusestatic = False
    mujoco.MjData(spec.compile())
except (ValueError, mujoco.FatalError):
    pass  # The caller reads it again and says why.
"""


def try_mjcf(path: Path, roots: list[ET.Element]) -> None:
    """Compile an MJCF file in another process, if it holds elements that could be bombs.

    Args:
        path: the file.
        roots: its root and those of all that it includes.

    Raises:
        SpecError: it takes too long or too much memory.
    """
    if not any(
        element.tag in RISKY or "builtin" in element.attrib
        for root in roots
        for element in root.iter()
    ):
        return
    seconds = file_bounds().timeout_s
    try:
        done = subprocess.run(
            [sys.executable, "-c", _CODE, str(path), str(_MEMORY)],
            capture_output=True,
            check=False,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        raise SpecError(
            f"{path}: MuJoCo takes over {seconds:g} s to read it; make it smaller, or raise "
            "files.timeout_s if you trust it"
        ) from None
    if done.returncode:
        last = done.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
        raise SpecError(
            f"{path}: MuJoCo cannot read it within {_MEMORY // MIB} MiB of memory, or breaks "
            f"down on it ({' '.join(last)[:200] or f'signal {-done.returncode}'}); make it smaller"
        )

"""Compile MJCF in a child process before this one does.

A few lines of MJCF can ask for grids, textures or sensors that exceed all memory or take hours.
"""

from pathlib import Path
from xml.etree import ElementTree as ET

from .bounded_process import run_bounded

RISKY = {"flexcomp", "composite", "replicate", "user", "size", "hfield", "texture", "skin", "flex"}
"""Elements whose attributes set how much memory they take."""
_CODE = """
import mujoco
try:
    spec = mujoco.MjSpec.from_file(sys.argv[1])
    spec.compiler.discardvisual = spec.compiler.fusestatic = False
    mujoco.MjData(spec.compile())
except (ValueError, mujoco.FatalError):
    pass  # The parent process reads the file as well and reports the error.
"""


def try_mjcf(path: Path, roots: list[ET.Element]) -> None:
    """Compile an MJCF file in a child process if it has elements that can exhaust memory.

    Args:
        path: the file.
        roots: its root element and those of all files that it includes.

    Raises:
        SpecError: it takes too much time or memory.
    """
    elements = (element for root in roots for element in root.iter())
    if any(element.tag in RISKY or "builtin" in element.attrib for element in elements):
        run_bounded(path, _CODE, str(path), library="MuJoCo", verb="read")

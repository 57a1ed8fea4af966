"""Checks an untrusted MJCF file and its includes, and lets MuJoCo compile it."""

import itertools
import os
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco

from ..errors import SpecError
from .asset_files import inside, inside_any, read_xml


def check_files(path: Path) -> str:
    """Check an MJCF file and all files that it includes, and return the name of the model.

    Raises:
        SpecError: a file is broken or hostile, refers to a file that is missing or outside the
            folder of `path`, or includes itself.
    """
    roots = _included(path, path, set())
    if roots[0].tag != "mujoco":
        raise SpecError(f"{path}: the root element of MJCF is <mujoco>, not <{roots[0].tag}>")
    elements = [element for root in roots for element in root.iter()]
    # MuJoCo decides which of several <compiler> elements applies, so all paths are checked.
    compilers = [element for element in elements if element.tag == "compiler"]
    stripped = any(compiler.get("strippath") == "true" for compiler in compilers)
    for element in elements:
        if element.tag in ("model", "attach", "plugin"):
            raise SpecError(
                f"{path}: <{element.tag}> is not supported; use one self-contained file"
            )
        if element.tag in ("include", "mujoco"):
            continue
        keys = ("assetdir", "texturedir" if element.tag == "texture" else "meshdir")
        folders = {folder for c in compilers for key in keys if (folder := c.get(key)) is not None}
        for key, value in element.attrib.items():
            if key.startswith("file"):
                names = {value, os.path.basename(value)} if stripped else {value}
                places = itertools.product(folders or {""}, names)
                inside_any(path, [os.path.join(*place) for place in places], value)
    return os.path.basename(roots[0].get("model") or "")


def _included(path: Path, main: Path, visited: set[Path]) -> list[ET.Element]:
    if path.resolve() in visited:
        raise SpecError(f"{path} includes itself")
    visited.add(path.resolve())
    root = read_xml(path)
    roots = [root]
    for element in root.iter("include"):
        roots += _included(inside(main, element.get("file") or ""), main, visited)
    return roots


def compiled(path: Path) -> mujoco.MjModel:
    """Return the compiled file, with all its geoms and bodies.

    Raises:
        SpecError: MuJoCo refuses the file.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.discardvisual = False
        spec.compiler.fusestatic = False
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())[:240]
        raise SpecError(f"{path} is refused by MuJoCo: {reason}") from None

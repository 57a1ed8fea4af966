"""Checks MJCF files and all files that they include, and compiles them with MuJoCo."""

import itertools
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from .checked_xml import inside, inside_any, read_xml

_FOLDERS = {"texture": ("assetdir", "texturedir")}
"""Attributes of <compiler> that name the folder of an element's files, by tag of the element."""
_OTHER_FOLDERS = ("assetdir", "meshdir")
"""Attributes of <compiler> that name the folder of the files of all other elements."""


def checked_roots(path: Path) -> list[ET.Element]:
    """Check an MJCF file and all files that it includes, and return their root elements.

    The first element is the root of `path`.

    Raises:
        SpecError: a file is broken or hostile, refers to a file that is missing or outside the
            folder of `path`, or includes itself.
    """
    roots = _included(path, path, set())
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
        keys = _FOLDERS.get(element.tag, _OTHER_FOLDERS)
        folders = {folder for c in compilers for key in keys if (folder := c.get(key)) is not None}
        for key, value in element.attrib.items():
            if key.startswith("file"):
                names = {value, os.path.basename(value)} if stripped else {value}
                places = itertools.product(folders or {""}, names)
                inside_any(path, [os.path.join(*place) for place in places], value)
    return roots


def _included(path: Path, main: Path, visited: set[Path]) -> list[ET.Element]:
    if path.resolve() in visited:
        raise SpecError(f"{path} includes itself")
    visited.add(path.resolve())
    root = read_xml(path)
    roots = [root]
    for element in root.iter("include"):
        roots += _included(inside(main, element.get("file") or ""), main, visited)
    return roots


def compiled_mjcf(
    path: Path, notes: list[str]
) -> tuple[mujoco.MjModel, dict[str, tuple[float, NDArray]], set[str]]:
    """Compile an MJCF file; if MuJoCo refuses its inertias, replace them and add a note.

    Returns:
        The model; the stated mass and moments of inertia of each body whose inertia was replaced,
        by body name; and the names of the bodies whose only mass is the compiler's lower bound.

    Raises:
        SpecError: MuJoCo refuses the file for another reason.
    """
    with _refusals(path):
        spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.discardvisual = False
    spec.compiler.fusestatic = False
    try:
        model = spec.compile()
        bound = float(spec.compiler.boundmass)
        massless = {b.name for b in spec.bodies if not b.explicitinertial}
        massless &= {model.body(b).name for b in range(model.nbody) if model.body_mass[b] <= bound}
        return model, {}, massless
    except (ValueError, mujoco.FatalError) as error:
        if "inertia" not in str(error) and "mass" not in str(error):
            raise SpecError(f"{path} is refused by MuJoCo: {_line(error)}") from None
        reason = _line(error)
    stated = {}
    for body in spec.bodies:
        if body.explicitinertial:
            stated[body.name] = (float(body.mass), np.array(body.inertia))
            body.mass, body.inertia = max(float(body.mass), 1e-6), np.full(3, 1e-6)
            body.fullinertia = np.full(6, np.nan)
    spec.compiler.balanceinertia, spec.compiler.boundmass = True, 1e-6
    spec.compiler.boundinertia = 1e-9
    with _refusals(path):
        model = spec.compile()
    notes.append(f"MuJoCo refuses the stated inertias, so they are not checked: {reason}")
    return model, stated, set()


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Convert errors of MuJoCo to SpecErrors that name the file."""
    try:
        yield
    except (ValueError, mujoco.FatalError) as error:
        raise SpecError(f"{path} is refused by MuJoCo: {_line(error)}") from None


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:240]

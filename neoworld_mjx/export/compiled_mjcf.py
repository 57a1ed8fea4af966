"""MJCF files from elsewhere, looked through with all that they include, and compiled by MuJoCo."""

import os
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from .checked_xml import inside, read_xml

FILES = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "texture": "texturedir"}


def checked_roots(path: Path, main: Path, visited: set[Path]) -> list[ET.Element]:
    """Check a file and all that it includes; return their roots, the main one first."""
    if path.resolve() in visited:
        raise SpecError(f"{path} includes itself")
    visited.add(path.resolve())
    root = read_xml(path)
    roots = [root]
    for element in root.iter("include"):
        roots += checked_roots(inside(main, element.get("file") or ""), main, visited)
    folders: dict[str, str] = {}
    for compiler in (c for r in roots for c in r.iter("compiler")):
        both = compiler.get("assetdir")
        if both is not None:
            folders |= {"meshdir": both, "texturedir": both}
        folders |= {k: v for k in ("meshdir", "texturedir") if (v := compiler.get(k)) is not None}
        if compiler.get("strippath") == "true":
            folders["strip"] = "true"
    for element in root.iter():
        if element.tag in ("model", "attach", "plugin"):
            raise SpecError(f"{path}: <{element.tag}> is not read; give one self-contained file")
        for key, value in element.attrib.items():
            if not key.startswith("file") or element.tag in ("include", "mujoco"):
                continue
            where = folders.get(FILES.get(element.tag, "meshdir"), "")
            named = os.path.basename(value) if "strip" in folders else value
            inside(main, named, where)
    return roots


def compiled_mjcf(
    path: Path, notes: list[str]
) -> tuple[mujoco.MjModel, dict[str, tuple[float, NDArray]], set[str]]:
    """Compile a file; one with impossible inertias is compiled with others.

    Returns:
        The model, the stated masses and moments by body where they were replaced, and the bodies
        whose only mass is the compiler's lower bound.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise SpecError(f"{path} is refused by MuJoCo: {_line(error)}") from None
    spec.compiler.discardvisual = False
    spec.compiler.fusestatic = False
    try:
        model = spec.compile()
        least = float(spec.compiler.boundmass)
        light = {b.name for b in spec.bodies if not b.explicitinertial}
        light &= {model.body(b).name for b in range(model.nbody) if model.body_mass[b] <= least}
        return model, {}, light
    except (ValueError, mujoco.FatalError) as error:
        if "inertia" not in str(error) and "mass" not in str(error):
            raise SpecError(f"{path} is refused by MuJoCo: {_line(error)}") from None
        why = _line(error)
    stated = {}
    for body in spec.bodies:
        if body.explicitinertial:
            stated[body.name] = (float(body.mass), np.array(body.inertia))
            body.mass, body.inertia = max(float(body.mass), 1e-6), np.full(3, 1e-6)
            body.fullinertia = np.full(6, np.nan)
    spec.compiler.balanceinertia, spec.compiler.boundmass = True, 1e-6
    spec.compiler.boundinertia = 1e-9
    try:
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SpecError(f"{path} is refused by MuJoCo: {_line(error)}") from None
    notes.append(f"MuJoCo refuses it as it is: {why}")
    return model, stated, set()


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:240]

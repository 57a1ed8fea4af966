"""Checks an untrusted MJCF file and its includes, compiles it, and names its bodies and joints."""

import itertools
import os
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ..errors import SpecError
from ..io.names import unused
from .asset_files import inside, inside_any, read_xml


def check_files(path: Path) -> str:
    """Check an MJCF file and all its files, and return the name of the model.

    Raises:
        SpecError: a file is broken or hostile, refers to a file that is missing or outside the
            folder of `path`, or includes itself.
    """
    return _check(path, (), set())


def _check(path: Path, outer: tuple[Path, ...], checked: set[Path]) -> str:
    """Check a model, and the models that it attaches unless they are checked; return its name."""
    outer = (*outer, path.resolve())
    checked.add(path.resolve())
    roots = _included(path, path, set())
    if roots[0].tag != "mujoco":
        raise SpecError(f"{path}: the root element of MJCF is <mujoco>, not <{roots[0].tag}>")
    elements = [element for root in roots for element in root.iter()]
    # MuJoCo decides which of several <compiler> elements applies, so all paths are checked.
    compilers = [element for element in elements if element.tag == "compiler"]
    stripped = any(compiler.get("strippath") == "true" for compiler in compilers)
    for element in elements:
        if element.tag == "plugin":
            raise SpecError(f"{path}: <plugin> is not supported, as it runs code")
        if element.tag == "model" and element.get("file"):
            attached = inside(path, element.get("file") or "")
            if attached.resolve() in outer:
                raise SpecError(f"{attached} attaches itself")
            if attached.resolve() not in checked:
                _check(attached, outer, checked)
            continue
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


def element_names(model: mujoco.MjModel) -> tuple[list[str], list[str]]:
    """Return the names of all bodies and joints; those that the file does not state are derived.

    Derived names avoid stated ones. The prefix "<object>-" of exported files is removed, so names
    are unique within the children of the world body.
    """
    bodies = _unique_names(model.body, model.nbody, lambda b: f"body_{b}")
    owner = [bodies[int(b)] for b in model.jnt_bodyid]
    joints = _unique_names(model.joint, model.njnt, lambda j: f"{owner[j]}_joint")
    _strip_prefixes(model, bodies, joints)
    return bodies, joints


def _unique_names(named: Callable[[int], Any], count: int, default: Callable) -> list[str]:
    """Return the names of elements; names that the file does not state avoid those it states."""
    names = [str(named(k).name) for k in range(count)]
    taken = set(names)
    for k, name in enumerate(names):
        if not name:
            names[k] = unused(default(k), taken)
            taken.add(names[k])
    return names


def _strip_prefixes(model: mujoco.MjModel, bodies: list[str], joints: list[str]) -> None:
    """Remove the prefix "<object>-", which exported files have, from the names in an object."""
    for top in np.flatnonzero(model.body_parentid[1:] == 0) + 1:
        prefix, tree = f"{bodies[top]}-", model.body_rootid == top
        own_bodies = np.flatnonzero(tree)[1:]
        own_joints = np.flatnonzero(
            tree[model.jnt_bodyid] & (model.jnt_type != mujoco.mjtJoint.mjJNT_FREE)
        )
        names = [*(bodies[b] for b in own_bodies), *(joints[j] for j in own_joints)]
        if all(name.startswith(prefix) for name in names) and prefix + bodies[top] not in names:
            for b in own_bodies:
                bodies[b] = bodies[b].removeprefix(prefix)
            for j in own_joints:
                joints[j] = joints[j].removeprefix(prefix)

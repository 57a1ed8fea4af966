"""Checks, compiles and describes an untrusted MJCF file.

A file and its includes are checked before MuJoCo reads them. Bodies and joints get unique names.
What a compiled model contains but an object cannot hold is noted with its value.
"""

import itertools
import os
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..errors import SpecError
from ..io.names import unused
from ..physics.mjcf import CONTACT_TIME_S, START
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


_ELEMENTS = {
    "ncam": "camera", "nu": "actuator", "nsensor": "sensor", "ntendon": "tendon", "nkey": "key",
    "nflex": "flex", "nskin": "skin", "npair": "pair", "nhfield": "hfield",
}  # fmt: skip
"""Field with the number of elements of a kind, and the name of the kind."""
_GEOM_FIELDS: dict[str, Sequence[ArrayLike]] = {
    "condim": (3,), "margin": (0,), "gap": (0,), "priority": (0,),
    "solref": ((0.02, 1), (CONTACT_TIME_S, 1)), "solimp": ((0.9, 0.95, 0.001, 0.5, 2),),
}  # fmt: skip
"""Fields of colliding geoms that objects lack, with the values that need no note."""
_OPTIONS = {"wind": "m/s", "density": "kg/m^3", "viscosity": "Pa s"}
"""Options of the medium, which is empty space in scenes, with their units."""
MAX_NAMES = 5


def listed(kind: str, names: Sequence[str]) -> str:
    """Return the number of elements of a kind, and the first of their names, as text."""
    stated = [name for name in names if name]
    rest = ", ..." if len(stated) > MAX_NAMES else ""
    text = f" ({', '.join(stated[:MAX_NAMES])}{rest})" if stated else ""
    return f"{len(names)} {kind}{'s' if len(names) != 1 else ''}{text}"


def unsupported(model: mujoco.MjModel) -> list[str]:
    """Return a note for each kind of element, option and value of a model that is not imported."""
    notes = []
    for field, kind in _ELEMENTS.items():
        kind_id = mujoco.mju_str2Type(kind)
        count = getattr(model, field)
        names = [mujoco.mj_id2name(model, kind_id, k) or "" for k in range(count)]
        names = [name for name in names if (kind, name) != ("key", START)]
        if names:
            notes.append(f"{listed(kind, names)} not imported")
    for signature in model.exclude_signature:
        one, other = (model.body(int(b)).name for b in divmod(int(signature), 1 << 16))
        if not _related(model, int(signature)):
            notes.append(f"bodies {one} and {other} never collide in the file: here they may")
    for name, unit in _OPTIONS.items():
        value = np.ravel(getattr(model.opt, name))
        if np.any(value):
            notes.append(f"{name} {_text(value)} {unit} is not kept")
    for flag, bit in mujoco.mjtDisableBit.__members__.items():
        if model.opt.disableflags & bit.value and flag[7:] in ("CONTACT", "CONSTRAINT", "LIMIT"):
            notes.append(f"the file disables {flag[7:].lower()}s: here they are enabled")
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    for name, usual in _GEOM_FIELDS.items():
        values = np.reshape(getattr(model, f"geom_{name}"), (model.ngeom, -1))[solid]
        odd = np.all([np.any(np.abs(values - v) > 1e-9, axis=1) for v in usual], axis=0)
        if odd.any():
            distinct = np.unique(values[odd], axis=0)
            stated = ", ".join(_text(row) for row in distinct[:3])
            more = ", ..." if len(distinct) > 3 else ""
            notes.append(f"{name} {stated}{more} of {odd.sum()} geoms is not kept")
    for b in np.flatnonzero(model.body_gravcomp):
        notes.append(f"body {model.body(b).name}: gravcomp {model.body_gravcomp[b]:g} is not kept")
    apart = _masked_pairs(model)
    if apart:
        notes.append(
            f"contype and conaffinity keep {apart} pairs of geoms apart: here they collide"
        )
    return notes


def _text(values: ArrayLike) -> str:
    return " ".join(f"{v:g}" for v in np.ravel(values))


def _related(model: mujoco.MjModel, signature: int) -> bool:
    """Return whether two bodies are welded or joined, so that objects exclude the pair, too."""
    one, other = (int(model.body_weldid[b]) for b in divmod(signature, 1 << 16))
    parents = [int(model.body_weldid[model.body_parentid[b]]) for b in (one, other)]
    return one in (other, parents[1]) or other == parents[0]


def _masked_pairs(model: mujoco.MjModel) -> int:
    """Return the number of pairs of geoms that collide with others, but not with each other."""
    masks = np.bitwise_and.outer(model.geom_contype, model.geom_conaffinity)
    touch = (masks | masks.T) != 0
    solid = touch.any(axis=1)
    weld = model.body_weldid[model.geom_bodyid]
    pair = solid[:, None] & solid[None] & (weld[:, None] != weld[None])
    return int(np.triu(pair & ~touch).sum())

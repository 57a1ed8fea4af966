"""Notes on what a compiled MJCF model contains and objects cannot hold, each with its value."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..physics.mjcf import CONTACT_TIME_S, START

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

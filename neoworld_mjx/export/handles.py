"""Frames of an object: the sites that its program names, and a handle for every moving part."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..spec import JointSpec, ObjectSpec, pieces
from ..spec.convex import box_around
from ..spec.kinematics import welded

HANDLE = re.compile(r"handle|knob|pull|grip|lever|finial", re.IGNORECASE)
"""Names of parts and geoms that are meant to be held."""
MARGIN_M = 0.005
"""Margin of the box around a held shape in which contacts count [m]."""


@dataclass(frozen=True)
class Frame:
    """A named point on a part; its axes are those of the object."""

    name: str
    part: str
    pos: tuple[float, float, float]
    """Position in the object's frame with all joints at 0 [m]."""
    half: tuple[float, float, float] | None = None
    """Half the edge lengths of a box around the held shape [m]; None for the sites of programs."""
    joint: str | None = None
    """Joint that the handle actuates; None for the sites of programs."""


def frames(spec: ObjectSpec) -> tuple[Frame, ...]:
    """Return an object's sites, and a frame <part>_handle for every part that a joint moves.

    A site <part>_handle on the part takes precedence. Otherwise the handle is the center of the
    geoms whose names match `HANDLE`, on the part or fixed to it, or else the center of the leading
    side of the part: the side that a slide moves towards, or the side farthest from a hinge or
    ball; for a continuous joint it is the center of the part. Mimic joints have no handle.
    """
    named = [Frame(site.name, site.part, site.pos) for site in spec.sites]
    taken = {site.name for site in spec.sites}
    parts = {(site.name, site.part) for site in spec.sites}
    result = []
    for joint in spec.joints:
        name = f"{joint.child}_handle"
        if joint.type == "fixed" or joint.mimic is not None or (name, joint.child) in parts:
            continue
        while name in taken:
            name += "_"
        taken.add(name)
        result.append(_handle(spec, joint, name))
    return (*named, *result)


def _handle(spec: ObjectSpec, joint: JointSpec, name: str) -> Frame:
    group = welded(spec)
    held, whole = [], []
    for part in spec.parts:
        if group[part.name] != group[joint.child]:
            continue
        for geom, piece, local in pieces(part):
            box = box_around(piece, local)
            whole.append(box)
            if HANDLE.search(geom.name) or (HANDLE.search(part.name) and part.name != spec.root):
                held.append(box)
    lows, highs = zip(*(held or whole), strict=True)
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    center, half = (low + high) / 2, (high - low) / 2
    if not held:
        center, half = _leading_side(joint, center, half)
    return Frame(name, joint.child, _triple(center), _triple(half + MARGIN_M), joint.name)


def _leading_side(joint: JointSpec, center: NDArray, half: NDArray) -> tuple[NDArray, NDArray]:
    """Return the center and half edges of the side of a box by which a part is moved."""
    if joint.type == "continuous":
        return center, half
    best, side = -np.inf, (0, 1.0)
    for k in range(3):
        for sign in (1.0, -1.0):
            face = center.copy()
            face[k] += sign * half[k]
            if joint.type == "prismatic":
                reach = sign * joint.axis[k]
            else:
                arm = face - np.array(joint.pos)
                along = np.array(joint.axis) if joint.type == "revolute" else np.zeros(3)
                reach = float(np.linalg.norm(arm - (arm @ along) * along))
            if reach > best + 1e-9:
                best, side = reach, (k, sign)
    k, sign = side
    middle, edges = center.copy(), half.copy()
    middle[k] += sign * half[k]
    edges[k] = 0.0
    return middle, edges


def _triple(values: NDArray) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 9) + 0.0 for v in values)
    return x, y, z

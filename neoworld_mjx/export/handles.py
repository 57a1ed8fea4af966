"""Frames of an object: the sites that its program names, and a handle of every part that moves."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..spec import JointSpec, ObjectSpec, pieces
from ..spec.convex import box_around
from ..spec.kinematics import welded

HANDLE = re.compile(r"handle|knob|pull|grip|lever|finial", re.IGNORECASE)
"""Names of parts and geoms that are made to be held."""
MARGIN_M = 0.005
"""How far beyond the held shape contacts with it may lie [m]."""


@dataclass(frozen=True)
class Frame:
    """A named point on a part, along the object's axes."""

    name: str
    part: str
    pos: tuple[float, float, float]
    """In the object's frame at rest [m]."""
    half: tuple[float, float, float] | None = None
    """Half the edges [m] of a box around what is held; None for the sites of programs."""
    joint: str | None = None
    """The joint that a handle works."""


def frames(spec: ObjectSpec) -> tuple[Frame, ...]:
    """List an object's sites, and a frame <part>_handle for every part that a joint moves.

    A handle is what its name says (handle, knob, pull, grip, lever, finial), on the part or fixed
    to it; a site of that name on the part is it. Without one it is the middle of the side that
    leads: of a slide the one it moves towards, of a hinge or ball the one farthest from it, of what
    turns without end its middle.
    Joints that follow others get none.
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
        for geom, piece, at in pieces(part):
            box = box_around(piece, at)
            whole.append(box)
            if HANDLE.search(geom.name) or (HANDLE.search(part.name) and part.name != spec.root):
                held.append(box)
    low, high = _around(held or whole)
    centre, half = (low + high) / 2, (high - low) / 2
    if not held:
        centre, half = _leading_side(joint, centre, half)
    return Frame(name, joint.child, _triple(centre), _triple(half + MARGIN_M), joint.name)


def _around(boxes: list[tuple[NDArray, NDArray]]) -> tuple[NDArray, NDArray]:
    lows, highs = zip(*boxes, strict=True)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _leading_side(joint: JointSpec, centre: NDArray, half: NDArray) -> tuple[NDArray, NDArray]:
    """Return the middle and half the edges of the side of a box by which a part is moved."""
    if joint.type == "continuous":
        return centre, half
    best, side = -np.inf, (0, 1.0)
    for k in range(3):
        for sign in (1.0, -1.0):
            face = centre.copy()
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
    middle, edges = centre.copy(), half.copy()
    middle[k] += sign * half[k]
    edges[k] = 0.0
    return middle, edges


def _triple(values: NDArray) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 9) + 0.0 for v in values)
    return x, y, z

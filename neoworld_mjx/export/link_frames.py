"""Frames, names and inertias of an object's links, and its sites and handles, for all writers.

The origin of a link's frame is the anchor of the joint that moves the link. The axes of the frame
are those of the object.
"""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..io.names import unused
from ..physics.mjcf import excluded_pairs
from ..spec import JointSpec, ObjectSpec, PartSpec, inertial, pieces
from ..spec.convex import box_around
from ..spec.kinematics import welded
from ..spec.pose import Pose, matrix

TENSOR_ENTRIES = {
    "ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2),
}  # fmt: skip
"""Indices of the entries of an inertia tensor, by the name of the entry in URDF and SDF."""


def link_origins(spec: ObjectSpec) -> dict[str, NDArray]:
    """Return the origin of each part's link, by part name.

    Origins are in the object's frame with all joints at zero [m], shape [3].
    """
    return {spec.root: np.zeros(3)} | {joint.child: np.array(joint.pos) for joint in spec.joints}


def link_names(spec: ObjectSpec) -> dict[str, str]:
    """Return the name of each part's link in URDF and SDF, by part name.

    The root link has the name of the object, and the other links have the names of their parts.
    """
    names = {part.name: part.name for part in spec.parts}
    root = spec.root
    return names | {root: unused(spec.name, names.keys() - {root})}


def unjoined_pairs(spec: ObjectSpec) -> list[tuple[str, str]]:
    """Return the pairs of parts that are excluded from collisions and that no joint connects."""
    joined = {(joint.parent, joint.child) for joint in spec.joints}
    return [pair for pair in excluded_pairs(spec) if pair not in joined]


def inertia_tensor(spec: ObjectSpec, part: PartSpec) -> NDArray:
    """Return the inertia of a part about its center of mass, in the object's axes [kg m^2]."""
    mass = inertial(spec, part)
    rotation = matrix(mass.quat)
    return rotation @ np.diag(mass.diagonal) @ rotation.T


def transform(pose: Pose) -> NDArray:
    """Return a pose as a homogeneous matrix [4, 4]."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = matrix(pose.quat), pose.pos
    return result


HANDLE = re.compile(r"handle|knob|pull|grip|lever|finial", re.IGNORECASE)
"""Pattern of the names of parts and geoms that serve as handles."""
MARGIN_M = 0.005
"""Margin of the box around a handle; contacts inside the box are contacts with the handle [m]."""


@dataclass(frozen=True)
class Frame:
    """Named point on a part, with the axes of the object."""

    name: str
    part: str
    pos: tuple[float, float, float]
    """Position in the object's frame with all joints at zero [m]."""
    half: tuple[float, float, float] | None = None
    """Half the edge lengths of a box around the handle [m]; None if the frame is a site."""
    joint: str | None = None
    """Joint that the handle actuates; None if the frame is a site."""


def frames(spec: ObjectSpec) -> tuple[Frame, ...]:
    """Return an object's sites, and a frame <part>_handle for each part that a joint moves.

    No frame is added for a mimic joint, or if the part has a site <part>_handle. Otherwise the
    handle is, in this order of precedence:

    - the center of the geoms whose names, or whose parts' names, match `HANDLE`, among the geoms of
      the moved part and of the parts fixed to it;
    - for a continuous joint, the center of the moved part;
    - for a prismatic joint, the center of the side toward which the part moves;
    - for a revolute or ball joint, the center of the side that is farthest from the joint.
    """
    site_frames = [Frame(site.name, site.part, site.pos) for site in spec.sites]
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
    return (*site_frames, *result)


def _handle(spec: ObjectSpec, joint: JointSpec, name: str) -> Frame:
    group = welded(spec)
    handle_boxes, boxes = [], []
    for part in spec.parts:
        if group[part.name] != group[joint.child]:
            continue
        for geom, piece, local in pieces(part):
            box = box_around(piece, local)
            boxes.append(box)
            if HANDLE.search(geom.name) or (HANDLE.search(part.name) and part.name != spec.root):
                handle_boxes.append(box)
    lows, highs = zip(*(handle_boxes or boxes), strict=True)
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    center, half = (low + high) / 2, (high - low) / 2
    if not handle_boxes:
        center, half = _leading_side(joint, center, half)
    return Frame(name, joint.child, _triple(center), _triple(half + MARGIN_M), joint.name)


def _leading_side(joint: JointSpec, center: NDArray, half: NDArray) -> tuple[NDArray, NDArray]:
    """Return the center and the half edge lengths of the side by which a part is moved [m].

    The box around the part is given by its center and its half edge lengths.
    """
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

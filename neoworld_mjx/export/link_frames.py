"""Frames, names and inertias of an object's links, which all writers use.

The origin of a link's frame is the anchor of the joint that moves the link. The axes of the frame
are those of the object.
"""

from collections.abc import Set as AbstractSet

import numpy as np
from numpy.typing import NDArray

from ..physics.mjcf import excluded_pairs
from ..spec import ObjectSpec, PartSpec, inertial
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


def unused(name: str, taken: AbstractSet[str]) -> str:
    """Append underscores to a name until it is not taken."""
    while name in taken:
        name += "_"
    return name


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

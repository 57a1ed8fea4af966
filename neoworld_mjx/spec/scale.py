"""Isotropic scaling of objects, and the exponents of all physical quantities.

Each field of a description declares its dimension (`dimensions.py`). Given the mass exponent m (3
for a derived mass, 0 for an authored mass), the exponents of s are

    quantity                     turning joint       sliding joint
    position, limits             0                   1
    armature                     m + 2  (inertia)    m      (mass)
    stiffness                    m + 1  (torque)     m - 1  (force / length)
    damping                      m + 3/2             m - 1/2
    friction loss, effort        m + 1  (torque)     m      (force)
    velocity limit               -1/2                1/2

where torque = mass g length and force = mass g. Lengths scale with s, and inertia scales with
s^(m + 2). The mass exponent of a joint is that of the joint's child part. `fit_to_box` returns the
scale that fits an object to its parsed 3D box.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .dimensions import Motion
from .joint import JointSpec, Mimic
from .kinematics import bounds
from .object import ObjectSpec, PartSpec, mass_exponent
from .opening import parsed_state
from .tree import PartState, TreeNode


def scale(spec: ObjectSpec, s: float) -> ObjectSpec:
    """Return the object scaled isotropically by `s` about its origin.

    Raises:
        ValueError: `s` is not a positive finite number.
    """
    if not 0 < s < float("inf"):
        raise ValueError(f"scale must be positive and finite, got {s}")
    return spec.scaled(s)


def scaled_state(spec: ObjectSpec, state: Mapping[str, float], s: float) -> dict[str, float]:
    """Return the joint values [rad or m] of an object after scaling by `s`."""
    slides = {joint.name for joint in spec.joints if joint.type == "prismatic"}
    return {name: value * (s if name in slides else 1.0) for name, value in state.items()}


def joint_exponents(joint: JointSpec, child: PartSpec) -> dict[str, float]:
    """Return the power of the scale factor s with which each numeric `JointSpec` field scales."""
    motion = Motion(mass=mass_exponent(child), slides=joint.type == "prismatic")
    return {
        name: scaling.exponent(motion)
        for name, scaling in JointSpec.scalings.items()
        if scaling is not None
    }


def mimic_exponents(joint: JointSpec, leader: JointSpec) -> tuple[float, float]:
    """Return the powers of s with which a mimic's multiplier and offset scale."""
    motion = Motion(slides=joint.type == "prismatic", leader_slides=leader.type == "prismatic")
    powers = (Mimic.scalings[name] for name in ("multiplier", "offset"))
    multiplier, offset = (0.0 if p is None else p.exponent(motion) for p in powers)
    return multiplier, offset


class BoxFit(NamedTuple):
    """Scale that fits an object, with joints as far open as in the photograph, to its 3D box."""

    spec: ObjectSpec
    """The object before scaling."""
    state: dict[str, float]
    """Joint values [rad or m] before scaling; see `parsed_state`."""
    unmatched: list[PartState]
    """Parsed movable parts that match no joint of the object."""
    low: NDArray
    """Lower corner of the object's bounds before scaling [m], shape [3]."""
    high: NDArray
    """Upper corner of the object's bounds before scaling [m], shape [3]."""
    ratio: NDArray
    """Edge lengths of the box divided by the edge lengths of the object's bounds, shape [3]."""
    factor: float
    """Isotropic scale factor."""

    def scaled(self) -> tuple[ObjectSpec, dict[str, float]]:
        """Return the scaled object and its joint values [rad or m]."""
        return scale(self.spec, self.factor), scaled_state(self.spec, self.state, self.factor)


def fit_to_box(spec: ObjectSpec, node: TreeNode) -> BoxFit:
    """Return the isotropic scale that fits an object to the 3D box of its node.

    The factor is the geometric mean of the ratios of the three edges, that is, the least-squares
    fit of the logarithms.
    """
    state, unmatched = parsed_state(spec, node)
    low, high = bounds(spec, state)
    ratio = np.array(node.box3d.size) / (high - low)
    factor = float(np.exp(np.mean(np.log(ratio))))
    return BoxFit(spec, state, unmatched, low, high, ratio, factor)

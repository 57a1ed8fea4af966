"""Mass properties of parts, authored or summed over collision pieces."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .base import Quat, Spec, Vec3
from .convex import mass_properties
from .joint import JointSpec
from .kinematics import pieces
from .object import ObjectSpec, PartSpec
from .pose import IDENTITY, conjugate, from_matrix, rotate


class Inertial(Spec):
    """Mass properties of a part in the object's frame."""

    mass: float
    """Mass [kg]."""
    pos: Vec3
    """Center of mass [m]."""
    quat: Quat
    """Orientation of the principal axes, (w, x, y, z)."""
    diagonal: Vec3
    """Principal moments of inertia about the center of mass [kg m^2]."""


LEAST_KG, LEAST_KG_M2 = 1e-9, 1e-14
"""Smallest mass and principal moment of a part. MuJoCo rejects values below 1e-15; the margin is
for objects that the search shrinks."""


def is_too_light(inertial: Inertial) -> bool:
    """Return whether a part has too little mass or inertia for simulation."""
    return not (inertial.mass >= LEAST_KG and min(inertial.diagonal) >= LEAST_KG_M2)


IMBALANCE = 0.02
"""Largest excess of an authored principal moment over the sum of the other two, relative to the
moment, that is rounding; the excess is removed."""


def inertia_fault(part: PartSpec, inertial: Inertial) -> str | None:
    """Return why no rigid body can have the inertia of a part, or why it is too light to simulate.

    Returns:
        A sentence with the values and the remedy; None if the inertia can be simulated.
    """
    a, b, c = sorted(inertial.diagonal)
    if part.inertia is not None and (a <= 0 or c > a + b):
        moments = ", ".join(f"{v:.3g}" for v in (a, b, c))
        return (
            f"part {part.name} states an inertia that no body has, with the principal moments "
            f"{moments} kg m^2 (each must be positive and at most the sum of the others): correct "
            "it, or let `neoworld check FILE --repair --out FOLDER` derive it from the colliders"
        )
    if is_too_light(inertial):
        return (
            f"part {part.name} weighs {inertial.mass:.3g} kg with a least moment of "
            f"{min(inertial.diagonal):.3g} kg m^2, too little to be simulated ({LEAST_KG:g} kg, "
            f"{LEAST_KG_M2:g} kg m^2): make it larger or denser"
        )
    return None


def inertial(spec: ObjectSpec, part: PartSpec) -> Inertial:
    """Return a part's mass properties: authored, or summed over its collision pieces."""
    used = {geom.material for geom in part.geoms}
    densities = {material.name: material.density for material in spec.materials}
    # The key of the cache contains only this part, because a lookup compares the whole key.
    return _cached(part, tuple(sorted((name, densities[name]) for name in used)))


def _summed(part: PartSpec, densities: tuple[tuple[str, float], ...]) -> Inertial:
    if part.inertia is not None and part.mass is not None:
        diagonal, quat = _principal(part.inertia.tensor())
        largest = int(np.argmax(diagonal))
        others = float(diagonal.sum() - diagonal[largest])
        # Numbers of a file are rounded, and MuJoCo rejects any excess.
        if others < diagonal[largest] <= others * (1 + IMBALANCE):
            diagonal[largest] = others * (1 - 1e-12)
        return Inertial(
            mass=part.mass, pos=part.inertia.pos, quat=quat, diagonal=tuple(diagonal.tolist())
        )
    mass, moment = 0.0, np.zeros(3)
    bodies = []
    for geom, piece, _ in pieces(part):
        volume, centre, unit = mass_properties(piece)
        m = volume * dict(densities)[geom.material]
        rotation = rotate(geom.pose().quat, np.eye(3)).T
        tensor = rotation @ unit @ rotation.T * (m / max(volume, 1e-300))
        bodies.append((m, geom.pose().apply(centre), tensor))
        mass += m
        moment += m * bodies[-1][1]
    # `is_too_light` reports a mass of zero.
    com = moment / max(mass, 1e-300)
    total = np.zeros((3, 3))
    for m, centre, tensor in bodies:
        d = centre - com
        total += tensor + m * (d @ d * np.eye(3) - np.outer(d, d))
    if part.mass is not None:
        total *= part.mass / max(mass, 1e-300)
        mass = part.mass
    diagonal, quat = _principal(total)
    return Inertial(
        mass=mass, pos=tuple(com.tolist()), quat=quat, diagonal=tuple(diagonal.tolist())
    )


_cached: Any = lru_cache(maxsize=512)(_summed)


def _principal(tensor: NDArray) -> tuple[NDArray, Quat]:
    size = float(np.trace(tensor)) or 1.0
    # Round, so that a scaled copy, whose tensor differs in the last bits, has the same axes even if
    # the object is symmetric.
    unit = np.round(tensor / size, 10)
    if np.allclose(unit, np.diag(np.diag(unit)), atol=1e-9):
        return np.diag(tensor).copy(), IDENTITY
    _, axes = np.linalg.eigh(unit)
    # Make the largest component of each eigenvector positive.
    for k in (0, 1):
        axes[:, k] *= np.sign(axes[np.argmax(np.abs(np.round(axes[:, k], 6))), k])
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    quat = from_matrix(axes)
    return np.diag(axes.T @ tensor @ axes).copy(), tuple(quat.tolist())


def inertia_about(joint: JointSpec, child: Inertial) -> float:
    """Return the inertia [kg m^2] that a joint moves or, for a prismatic joint, the mass [kg].

    The inertia is that of the child about the joint's axis. For a ball joint, the moment about the
    center of mass is the child's largest principal moment.
    """
    if joint.type == "prismatic":
        return child.mass
    arm = np.array(child.pos) - np.array(joint.pos)
    if joint.type == "ball":
        about_com = max(child.diagonal)
    else:
        axis = np.array(joint.axis)
        arm = arm - (arm @ axis) * axis
        about_com = rotate(conjugate(child.quat), axis) ** 2 @ np.array(child.diagonal)
    return float(about_com) + child.mass * float(arm @ arm)

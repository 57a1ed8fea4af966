"""Physical dimensions of fields, and their scaling with the size of an object.

Gravity and densities are constant, so time scales with sqrt(s) (Froude similarity). A quantity of
dimension mass^a length^b time^c scales with s^(a m + b + c / 2). The mass exponent m is 3 for a
mass derived from volume and density, and 0 for an authored mass. Every numeric field of a
`ScalableSpec` declares a `Scaling` in its annotation.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

DERIVED_MASS, AUTHORED_MASS = 3.0, 0.0
"""Mass exponents m: powers of s with which masses scale."""


class Dimension(NamedTuple):
    """Exponents of mass, length and time in the unit of a quantity."""

    mass: int = 0
    length: int = 0
    time: int = 0


class Motion(NamedTuple):
    """Properties of a joint that determine how its quantities scale; the default is no joint."""

    mass: float = AUTHORED_MASS
    """Mass exponent of the joint's child."""
    slides: bool = False
    """True if the joint is prismatic."""
    leader_slides: bool = False
    """True if the leader, the joint that this joint mimics, is prismatic."""


NO_JOINT = Motion()


@dataclass(frozen=True)
class Scaling:
    """Dimension of a field, given as metadata of `Annotated`."""

    turning: Dimension
    """Dimension for turning joints, and for quantities without a joint."""
    sliding: Dimension | None = None
    """Dimension for prismatic joints; if None, `turning` applies to them."""
    per_leader: "Scaling | None" = None
    """Scaling of the leader's quantity by which this quantity is divided."""

    def exponent(self, motion: Motion = NO_JOINT) -> float:
        """Return the power of s with which the field scales."""
        dimension = self.sliding if motion.slides and self.sliding is not None else self.turning
        power = dimension.mass * motion.mass + dimension.length + dimension.time / 2
        if self.per_leader is not None:
            leader = Motion(mass=motion.mass, slides=motion.leader_slides)
            power -= self.per_leader.exponent(leader)
        return power


UNSCALED = Scaling(Dimension())
"""Scaling of ratios, directions, colors, counts, densities and authored masses, and of operands
that are described at size 1."""
LENGTH = Scaling(Dimension(length=1))
INERTIA = Scaling(Dimension(mass=1, length=2))
POSITION = Scaling(Dimension(), sliding=Dimension(length=1))
SPEED = Scaling(Dimension(time=-1), sliding=Dimension(length=1, time=-1))
EFFORT = Scaling(Dimension(1, 2, -2), sliding=Dimension(1, 1, -2))
"""Scaling of a torque or, for prismatic joints, of a force."""
STIFFNESS = Scaling(Dimension(1, 2, -2), sliding=Dimension(1, 0, -2))
DAMPING = Scaling(Dimension(1, 2, -1), sliding=Dimension(1, 0, -1))
ARMATURE = Scaling(Dimension(1, 2, 0), sliding=Dimension(1, 0, 0))
RATIO = Scaling(POSITION.turning, sliding=POSITION.sliding, per_leader=POSITION)
"""Scaling of the position of a joint divided by the position of its leader."""


def declared_scaling(annotation: Any, metadata: Iterable[object] = ()) -> Scaling | None:
    """Return the scaling that a field's annotation declares, or None for a field without numbers.

    Raises:
        TypeError: a number has no `Scaling`, or the numbers of the field have different ones.
    """
    scalings = _scalings(annotation, metadata)
    if None in scalings:
        raise TypeError("holds a number without a Scaling, such as Annotated[float, LENGTH]")
    if len(scalings) > 1:
        raise TypeError(f"mixes numbers that scale differently: {scalings}")
    return next(iter(scalings), None)


def _scalings(annotation: Any, metadata: Iterable[object] = ()) -> set[Scaling | None]:
    scalings = {item for item in metadata if isinstance(item, Scaling)}
    origin = get_origin(annotation)
    if scalings or origin is Literal:
        return {*scalings}
    if origin is Annotated:
        inner, *rest = get_args(annotation)
        return _scalings(inner, rest)
    if origin is not None:
        return set().union(*map(_scalings, get_args(annotation)))
    return {None} if annotation in (int, float) else set()

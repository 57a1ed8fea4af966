"""Physical dimensions of fields, and their scaling with the size of an object.

Gravity and densities are constant, so time scales with sqrt(s) (Froude similarity): a quantity of
dimension mass^a length^b time^c scales with s^(a m + b + c / 2), where m is 3 for a mass derived
from volume and density, and 0 for an authored one. Every numeric field of a `ScalableSpec` declares
its `Scaling` in its annotation.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

DERIVED_MASS, AUTHORED_MASS = 3.0, 0.0
"""Exponents of s for masses."""


class Dimension(NamedTuple):
    """Exponents of mass, length and time in a quantity's unit."""

    mass: int = 0
    length: int = 0
    time: int = 0


class Motion(NamedTuple):
    """Properties of a joint that determine the scaling of its quantities; no joint by default."""

    mass: float = AUTHORED_MASS
    """Exponent of s of the mass of the joint's child."""
    slides: bool = False
    """True for a prismatic joint."""
    leader_slides: bool = False
    """True if the joint that it follows is prismatic."""


NO_JOINT = Motion()


@dataclass(frozen=True)
class Scaling:
    """Dimension of a field; metadata for `Annotated`."""

    turning: Dimension
    """For turning joints, and for quantities without a joint."""
    sliding: Dimension | None = None
    """For prismatic joints; None if the same."""
    per_leader: "Scaling | None" = None
    """Quantity of the followed joint by which this one is divided."""

    def exponent(self, motion: Motion = NO_JOINT) -> float:
        """Return the exponent of s of the field."""
        dimension = self.sliding if motion.slides and self.sliding is not None else self.turning
        power = dimension.mass * motion.mass + dimension.length + dimension.time / 2
        if self.per_leader is not None:
            leader = Motion(mass=motion.mass, slides=motion.leader_slides)
            power -= self.per_leader.exponent(leader)
        return power


UNSCALED = Scaling(Dimension())
"""Ratios, directions, colours, counts, densities, authored masses; parts described at size 1."""
LENGTH = Scaling(Dimension(length=1))
INERTIA = Scaling(Dimension(mass=1, length=2))
POSITION = Scaling(Dimension(), sliding=Dimension(length=1))
SPEED = Scaling(Dimension(time=-1), sliding=Dimension(length=1, time=-1))
EFFORT = Scaling(Dimension(1, 2, -2), sliding=Dimension(1, 1, -2))
"""Torque, or force."""
STIFFNESS = Scaling(Dimension(1, 2, -2), sliding=Dimension(1, 0, -2))
DAMPING = Scaling(Dimension(1, 2, -1), sliding=Dimension(1, 0, -1))
ARMATURE = Scaling(Dimension(1, 2, 0), sliding=Dimension(1, 0, 0))
RATIO = Scaling(POSITION.turning, sliding=POSITION.sliding, per_leader=POSITION)
"""Position of a joint per position of the one that it follows."""


def declared_scaling(annotation: Any, metadata: Iterable[object] = ()) -> Scaling | None:
    """Return the scaling in a field's annotation; None for a field that holds no numbers itself.

    Raises:
        TypeError: a number has no `Scaling`, or numbers of one field have different ones.
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

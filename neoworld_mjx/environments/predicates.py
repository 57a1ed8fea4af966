"""Success predicates: conditions on a simulated state, each with units and source.

`holds` tells whether a state fulfils the condition, `distance` how far it is from its bounds, and
`progress` is its closeness in [0, 1]; 1 does not imply success. All compute with NumPy, or with JAX
under `jit` and `vmap`; a `StateReader` reads the state. The benchmark evaluates predicates in every
state of the last second of a simulation, and they must hold in all of them.
"""

import math
from typing import Annotated, Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..spec import Spec, Vec3
from ..spec.base import Name, Number
from ..spec.pose import length, quat_mul, rotate

AT_REST_M_S = 0.01
"""Speed below which an object rests: StackCube-v1 of ManiSkill, `is_static(lin_thresh=1e-2)`."""
AT_REST_RAD_S = 0.5
"""StackCube-v1 of ManiSkill, `ang_thresh=0.5`."""
JOINT_RAD_S, JOINT_M_S = 1.0, 0.1
"""Speeds of a joint that rests: OpenCabinetDrawer-v1 of ManiSkill, `link_is_static`."""

NEAR_M = 0.02
"""Distance at which a tool has reached a point [m]."""
BACK = np.array([1.0, -1.0, -1.0, -1.0])
"""Signs of a quaternion's inverse."""


@runtime_checkable
class StateReader(Protocol):
    """Reads what predicates need from a state. Values are arrays of `xp`: NumPy or JAX."""

    @property
    def xp(self) -> Any:
        """`numpy` or `jax.numpy`."""
        ...

    def pose(self, name: str, part: str | None = None) -> tuple[Any, Any]:
        """Return the position and orientation of an object, or of a part, whose frame at rest
        is that of the object.
        """
        ...

    def speed(self, name: str) -> tuple[Any, Any]:
        """Return the speeds of an object's root [m/s], [rad/s]."""
        ...

    def joint(self, name: str, joint: str, *, fraction: bool) -> tuple[Any, Any, bool]:
        """Return a joint's value, or its share of the range, its rate [rad/s or m/s], and whether
        it slides.
        """
        ...

    def touches(self, name: str, other: str) -> Any:
        """Return True if two objects touch."""
        ...

    def held(self, name: str) -> Any:
        """Return True if a gripper touches an object."""
        ...

    def tool_position(self) -> Any:
        """Return the position of the tool [m]."""
        ...


Cosine = Annotated[float, Field(ge=0, le=math.pi)]
Positive = Annotated[float, Field(gt=0)]


class Condition(Spec):
    """A predicate about one object, which holds within bounds; subclasses have `distance`."""

    SCALE: ClassVar[float] = 1.0
    """Distance at which the progress has fallen to 1/e, in the unit of the distance."""
    object: Name
    source: str

    def holds(self, world: StateReader) -> Any:
        """Return True if the state fulfils the predicate."""
        return self.distance(world) <= 0

    def progress(self, world: StateReader) -> Any:
        """Return the progress, which falls with the distance from the bounds."""
        return world.xp.exp(-self.distance(world) / self.SCALE)

    def distance(self, world: StateReader) -> Any:
        """Return the distance from the bounds."""
        raise NotImplementedError


class Located(Condition):
    """A point of an object lies within a cylinder in the frame of another, and the object is at
    rest.

    Placement, insertion and assembly tasks use it.
    """

    SCALE = 0.05
    type: Literal["located"] = "located"
    point: Vec3 = (0.0, 0.0, 0.0)
    """In the object's frame [m]."""
    relative_to: Name
    """The other object; its frame is that of its root part."""
    part: Name | None = None
    """A part of the other object, whose frame counts at rest instead."""
    target: Vec3
    """Axis of the cylinder in that frame; `low` and `high` count from its z [m]."""
    radius: Positive
    """Largest distance from the axis, which is the frame's z [m]."""
    low: Number
    high: Number
    """Bounds of the height above `target` [m]."""
    tilt: tuple[Cosine, Cosine] = (0.0, math.pi)
    """Bounds of the angle between the object's z and the vertical [rad]."""
    heading: Annotated[float, Field(ge=0, le=math.pi)] = math.pi
    """Largest turn between the two objects about the vertical [rad]."""
    touching: tuple[Name, ...] = ()
    """Objects that it must touch: what supports it."""
    released: bool = True
    """True if the gripper must not touch it."""
    rest: bool = True
    """True if it must be at rest."""

    def holds(self, world: StateReader) -> Any:
        """Return True if the state fulfils the predicate."""
        holds = self.distance(world) <= 0
        if self.rest:
            linear, angular = world.speed(self.object)
            holds = holds & (linear <= AT_REST_M_S) & (angular <= AT_REST_RAD_S)
        if self.released:
            holds = holds & ~world.held(self.object)
        for other in self.touching:
            holds = holds & world.touches(self.object, other)
        return holds

    def distance(self, world: StateReader) -> Any:
        """Return the violation of the bounds [m]; 0.1 rad count as 1 cm."""
        xp = world.xp
        base_quat = world.pose(self.relative_to, self.part)[1]
        quat = world.pose(self.object)[1]
        local = -rotate(base_quat * BACK, self.offset(world), xp)
        tilt = _tilt(quat, xp)
        zero = 0.0 * tilt
        largest = lambda *values: xp.max(xp.stack([zero, *values]))
        return (
            largest(length(local[:2], xp) - self.radius)
            + largest(self.low - local[2], local[2] - self.high)
            + 0.1 * largest(self.tilt[0] - tilt, tilt - self.tilt[1])
            + 0.1 * largest(_heading(base_quat, quat, xp) - self.heading)
        )

    def aim(self, world: StateReader) -> Any:
        """Return the position of the target [m]."""
        base, turn = world.pose(self.relative_to, self.part)
        return base + rotate(turn, world.xp.asarray(self.target), world.xp)

    def offset(self, world: StateReader) -> Any:
        """Return the displacement from the point to the target, in the world's axes [m]."""
        pos, quat = world.pose(self.object)
        return self.aim(world) - pos - rotate(quat, world.xp.asarray(self.point), world.xp)

    def meaning(self) -> str:
        """Return a description in one line."""
        where = f"{self.relative_to}.{self.part}" if self.part else self.relative_to
        text = (
            f"point {_mm(self.point)} of {self.object} within {1000 * self.radius:.0f} mm of "
            f"{_mm(self.target)} in {where}, {1000 * self.low:.0f} to {1000 * self.high:.0f} mm "
            "above it"
        )
        if self.tilt != (0.0, math.pi):
            low, high = (math.degrees(v) for v in self.tilt)
            text += f", leaning {low:.0f} to {high:.0f} deg"
        if self.heading < math.pi:
            text += f", turned by at most {math.degrees(self.heading):.0f} deg"
        if self.touching:
            text += ", touching " + " and ".join(self.touching)
        text += ", at rest" if self.rest else ""
        return text + (", released" if self.released else "")


class Leaning(Condition):
    """An object leans by an angle within bounds: toppled, or set upright."""

    type: Literal["leaning"] = "leaning"
    tilt: tuple[Cosine, Cosine]
    """Bounds of the angle between its z and the vertical [rad]."""

    def distance(self, world: StateReader) -> Any:
        """Return the angle outside the bounds [rad]."""
        xp = world.xp
        angle = _tilt(world.pose(self.object)[1], xp)
        return xp.max(xp.stack([0.0 * angle, self.tilt[0] - angle, angle - self.tilt[1]]))

    def meaning(self) -> str:
        """Return a description in one line."""
        low, high = (math.degrees(v) for v in self.tilt)
        return f"{self.object} leans {low:.0f} to {high:.0f} deg"


class JointBetween(Condition):
    """A joint's value lies within bounds, and the joint is at rest."""

    SCALE = 0.5
    type: Literal["joint"] = "joint"
    joint: Name
    low: Number
    high: Number
    """Bounds: fractions of the joint's range, or with `absolute` its value [rad or m]."""
    absolute: bool = False

    def holds(self, world: StateReader) -> Any:
        """Return True if the state fulfils the predicate."""
        value, rate, slides = world.joint(self.object, self.joint, fraction=not self.absolute)
        slow = rate <= (JOINT_M_S if slides else JOINT_RAD_S)
        return (self.low <= value) & (value <= self.high) & slow

    def distance(self, world: StateReader) -> Any:
        """Return the distance from the bounds, in their unit."""
        value, _, _ = world.joint(self.object, self.joint, fraction=not self.absolute)
        value = world.xp.asarray(value)
        return world.xp.max(world.xp.stack([0.0 * value, self.low - value, value - self.high]))

    def meaning(self) -> str:
        """Return a description in one line."""
        unit = "rad or m" if self.absolute else "of its range"
        high = "" if self.high > 1e3 or (self.high >= 1 and not self.absolute) else self.high
        low = "" if self.low < -1e3 or (self.low <= 0 and not self.absolute) else self.low
        if low != "" and high != "":
            bounds = f"{low:g} to {high:g}"
        else:
            bounds = f"at least {low:g}" if high == "" else f"at most {high:g}"
        return f"{self.object}/{self.joint} {bounds} {unit}, at rest"


class Reached(Condition):
    """The tool is at a point of a part of an object."""

    SCALE = 0.05
    type: Literal["reached"] = "reached"
    part: Name | None = None
    point: Vec3
    """In the frame of the part at rest, which is that of the object [m]."""

    def distance(self, world: StateReader) -> Any:
        """Return the distance of the tool from the point, less `NEAR_M` [m]."""
        xp = world.xp
        pos, quat = world.pose(self.object, self.part)
        apart = length(world.tool_position() - pos - rotate(quat, xp.asarray(self.point), xp), xp)
        return xp.maximum(apart - NEAR_M, 0.0)

    def meaning(self) -> str:
        """Return a description in one line."""
        return f"the tool within {1000 * NEAR_M:.0f} mm of {_mm(self.point)} of {self.object}"


class Every(Spec):
    """Conjunction of several predicates."""

    type: Literal["every"] = "every"
    of: tuple["Located | Leaning | JointBetween | Reached", ...] = Field(min_length=1)

    def holds(self, world: StateReader) -> Any:
        """Return True if the state fulfils each of them."""
        return world.xp.all(world.xp.stack([part.holds(world) for part in self.of]))

    def progress(self, world: StateReader) -> Any:
        """Return the mean progress."""
        return world.xp.mean(world.xp.stack([part.progress(world) for part in self.of]))

    def distance(self, world: StateReader) -> Any:
        """Return the mean distance."""
        return world.xp.mean(world.xp.stack([part.distance(world) for part in self.of]))

    def meaning(self) -> str:
        """Return a description in one line."""
        return "; ".join(part.meaning() for part in self.of)

    @property
    def source(self) -> str:
        """Sources of all of them."""
        return "; ".join(dict.fromkeys(part.source for part in self.of))


Predicate = Located | Leaning | JointBetween | Reached | Every


def _tilt(quat: Any, xp: Any) -> Any:
    """Return the angle between an object's z and the vertical [rad]."""
    return xp.arccos(xp.clip(1 - 2 * (quat[1] ** 2 + quat[2] ** 2), -1.0, 1.0))


def _heading(base: Any, quat: Any, xp: Any) -> Any:
    """Return the turn between two objects about the vertical of the first, from 0 to pi [rad]."""
    relative = quat_mul(base * BACK, quat, xp)
    return 2 * xp.arctan2(xp.abs(relative[3]), xp.abs(relative[0]))


def _mm(point: Vec3 | NDArray) -> str:
    return "(" + ", ".join(f"{1000 * v:.0f}" for v in point) + ") mm"


def leaves(predicate: Predicate) -> tuple[Located | Leaning | JointBetween | Reached, ...]:
    """Return the predicates of a conjunction, or the predicate alone."""
    return predicate.of if isinstance(predicate, Every) else (predicate,)


def named_objects(predicate: Predicate) -> set[str]:
    """Return the objects that a predicate names."""
    parts = leaves(predicate)
    others = {leaf.relative_to for leaf in parts if isinstance(leaf, Located)}
    return {leaf.object for leaf in parts} | others

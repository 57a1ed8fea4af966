"""Success predicates: conditions on a simulated state, each with units and source. A predicate is
evaluated in every state of the last second of a simulation, and must hold in all of them.
`progress` is the closeness of a state to it in [0, 1], for feedback into refinement; 1 does not
imply success."""

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from neoworld_mjx.spec import Spec, Vec3
from neoworld_mjx.spec.base import Name, Number
from neoworld_mjx.spec.pose import Pose, conjugate, quat_mul

from .world import World

AT_REST_M_S = 0.01
"""Speed below which an object rests: StackCube-v1 of ManiSkill, `is_static(lin_thresh=1e-2)`."""
AT_REST_RAD_S = 0.5
"""StackCube-v1 of ManiSkill, `ang_thresh=0.5`."""
JOINT_RAD_S, JOINT_M_S = 1.0, 0.1
"""Speeds of a joint that rests: OpenCabinetDrawer-v1 of ManiSkill, `link_is_static`."""

Cosine = Annotated[float, Field(ge=0, le=math.pi)]
Positive = Annotated[float, Field(gt=0)]


class Located(Spec):
    """A point of an object lies within a cylinder in the frame of another, and the object is at
    rest.

    Placement, insertion and assembly tasks use it.
    """

    type: Literal["located"] = "located"
    object: Name
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
    source: str

    def holds(self, world: World) -> bool:
        """Return True if the state fulfils the predicate."""
        if self._distance(world) > 0 or not world.at_rest(self.object, AT_REST_M_S, AT_REST_RAD_S):
            return False
        touched = world.touched(self.object)
        if self.released and world.GRIPPER in touched:
            return False
        return set(self.touching) <= touched

    def progress(self, world: World) -> float:
        """Return the progress, which falls with the distance from the cylinder."""
        return math.exp(-self._distance(world) / 0.05)

    def _distance(self, world: World) -> float:
        """Return the violation of the bounds [m]; 0.1 rad count as 1 cm."""
        base, object_pose = world.pose(self.relative_to, self.part), world.pose(self.object)
        local = base.inverse().apply(object_pose.apply(np.array(self.point))) - np.array(
            self.target
        )
        z = object_pose.apply(np.array([0.0, 0.0, 1.0])) - object_pose.pos
        tilt = math.acos(float(np.clip(z[2], -1.0, 1.0)))
        turn = _heading(base, object_pose)
        return (
            max(0.0, float(np.hypot(local[0], local[1])) - self.radius)
            + max(0.0, self.low - local[2], local[2] - self.high)
            + 0.1 * max(0.0, self.tilt[0] - tilt, tilt - self.tilt[1])
            + 0.1 * max(0.0, turn - self.heading)
        )

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
        return text + ", at rest" + (", released" if self.released else "")


class Leaning(Spec):
    """An object leans by an angle within bounds: toppled, or set upright."""

    type: Literal["leaning"] = "leaning"
    object: Name
    tilt: tuple[Cosine, Cosine]
    """Bounds of the angle between its z and the vertical [rad]."""
    source: str

    def holds(self, world: World) -> bool:
        """Return True if the state fulfils the predicate."""
        return self.tilt[0] <= self._angle(world) <= self.tilt[1]

    def progress(self, world: World) -> float:
        """Return the progress, which falls with the angle outside the bounds."""
        angle = self._angle(world)
        return math.exp(-max(0.0, self.tilt[0] - angle, angle - self.tilt[1]))

    def _angle(self, world: World) -> float:
        object_pose = world.pose(self.object)
        z = object_pose.apply(np.array([0.0, 0.0, 1.0])) - object_pose.pos
        return math.acos(float(np.clip(z[2], -1.0, 1.0)))

    def meaning(self) -> str:
        """Return a description in one line."""
        low, high = (math.degrees(v) for v in self.tilt)
        return f"{self.object} leans {low:.0f} to {high:.0f} deg"


class JointBetween(Spec):
    """A joint's value lies within bounds, and the joint is at rest."""

    type: Literal["joint"] = "joint"
    object: Name
    joint: Name
    low: Number
    high: Number
    """Bounds: fractions of the joint's range, or with `absolute` its value [rad or m]."""
    absolute: bool = False
    source: str

    def holds(self, world: World) -> bool:
        """Return True if the state fulfils the predicate."""
        value, rate, slides = world.joint(self.object, self.joint, fraction=not self.absolute)
        return self.low <= value <= self.high and rate <= (JOINT_M_S if slides else JOINT_RAD_S)

    def progress(self, world: World) -> float:
        """Return the progress, which falls with the distance from the bounds."""
        value, _, _ = world.joint(self.object, self.joint, fraction=not self.absolute)
        return math.exp(-2 * max(0.0, self.low - value, value - self.high))

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


class Every(Spec):
    """Conjunction of several predicates."""

    type: Literal["every"] = "every"
    of: tuple["Located | Leaning | JointBetween", ...] = Field(min_length=1)

    def holds(self, world: World) -> bool:
        """Return True if the state fulfils each of them."""
        return all(part.holds(world) for part in self.of)

    def progress(self, world: World) -> float:
        """Return the mean progress."""
        return float(np.mean([part.progress(world) for part in self.of]))

    def meaning(self) -> str:
        """Return a description in one line."""
        return "; ".join(part.meaning() for part in self.of)

    @property
    def source(self) -> str:
        """Sources of all of them."""
        return "; ".join(dict.fromkeys(part.source for part in self.of))


Predicate = Located | Leaning | JointBetween | Every


def _heading(base: Pose, at: Pose) -> float:
    relative = quat_mul(conjugate(base.quat), at.quat)
    return abs(math.remainder(2 * math.atan2(relative[3], relative[0]), 2 * math.pi))


def _mm(point: Vec3 | NDArray) -> str:
    return "(" + ", ".join(f"{1000 * v:.0f}" for v in point) + ") mm"


__all__ = ["Every", "JointBetween", "Leaning", "Located", "Predicate"]


def named_objects(predicate: Predicate) -> set[str]:
    """Return the objects that a predicate names."""
    leaves = predicate.of if isinstance(predicate, Every) else (predicate,)
    others = {leaf.relative_to for leaf in leaves if isinstance(leaf, Located)}
    return {leaf.object for leaf in leaves} | others

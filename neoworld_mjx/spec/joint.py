"""Joints of an object: type, axis, limits, dynamics and intent."""

import math
from collections.abc import Collection
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from ..errors import choices
from .base import Direction3, Name, Number, Point3, ScalableSpec, Vec3, unit_vector
from .dimensions import ARMATURE, DAMPING, EFFORT, POSITION, RATIO, SPEED, STIFFNESS

JointType = Literal["fixed", "revolute", "continuous", "prismatic", "ball"]
NonNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]


def _is_empty(value: object) -> bool:
    return value is None or value == ()


class Mimic(ScalableSpec):
    """A joint that follows another: q = multiplier * q_other + offset."""

    joint: Name
    multiplier: Annotated[Number, RATIO] = 1.0
    offset: Annotated[Number, POSITION] = 0.0


class Intent(ScalableSpec):
    """Intended motion of a joint, which checks compare with the actual one; physics ignores it."""

    type: JointType | None = None
    opens: Direction3 | None = None
    """Initial direction of the child's motion when the joint leaves 0 in the positive sense."""
    travel: Annotated[Positive, POSITION] | None = None
    """Least useful range [rad or m]."""


class JointSpec(ScalableSpec):
    """A joint from `parent` to `child`, with anchor and axis in the object's frame at rest.

    Units are rad, N m for turning joints and m, N for sliding ones. Positive motion turns or moves
    the child by the right-hand rule about, or along, `axis`; by convention positive opens.

    A ball joint turns about `pos` in any direction, by at most `upper` away from rest; 0 is no
    limit. It does not use axis, lower limit, effort, velocity and mimic. Its position is a rotation
    vector in the object's axes, given as three values `<joint>.x`, `.y` and `.z` [rad].
    """

    name: Name
    type: JointType
    parent: Name
    child: Name
    pos: Point3 = (0.0, 0.0, 0.0)
    axis: Direction3 = (0.0, 0.0, 1.0)
    lower: Annotated[Number, POSITION] = 0.0
    upper: Annotated[Number, POSITION] = 0.0
    damping: Annotated[NonNegative, DAMPING] = 0.0
    friction: Annotated[NonNegative, EFFORT] = 0.0
    """Dry friction (MuJoCo's frictionloss)."""
    stiffness: Annotated[NonNegative, STIFFNESS] = 0.0
    armature: Annotated[NonNegative, ARMATURE] = 0.0
    effort: Annotated[Positive, EFFORT] | None = None
    velocity: Annotated[Positive, SPEED] | None = None
    mimic: Mimic | None = None
    after: tuple[Name, ...] = Field(default=(), exclude_if=_is_empty)
    """Joints that must be fully open whenever this one is away from 0, such as the door in front of
    a rack. Checks test this; physics ignores it."""
    intent: Intent | None = Field(default=None, exclude_if=_is_empty)

    @field_validator("axis")
    @classmethod
    def _unit(cls, value: Vec3) -> Vec3:
        return unit_vector(value, "axis")

    @model_validator(mode="after")
    def _ordered(self) -> "JointSpec":
        if self.type in ("revolute", "prismatic") and not self.lower < self.upper:
            raise ValueError(
                f"joint {self.name}: lower {self.lower} must be below upper {self.upper}"
            )
        if self.type == "ball":
            if self.lower != 0.0 or not 0.0 <= self.upper <= math.pi:
                raise ValueError(
                    f"joint {self.name}: a ball turns from 0 to at most pi (upper 0: no limit), "
                    f"got {self.lower} to {self.upper}"
                )
            if (self.mimic, self.effort, self.velocity) != (None, None, None):
                raise ValueError(f"joint {self.name}: a ball has no mimic, effort or velocity")
        return self


def check_prerequisites(joint: JointSpec, by_name: dict[str, JointSpec]) -> None:
    """Validate the joints in `after`.

    Raises:
        ValueError: one is unknown, has no limits, or is the joint itself.
    """
    if joint.after and (joint.type == "fixed" or joint.mimic is not None):
        raise ValueError(f"joint {joint.name}: what is fixed or follows another cannot wait")
    waiting, visited = list(joint.after), set()
    while waiting:
        name = waiting.pop()
        require_known(f"joint {joint.name}: after", name, by_name)
        if name == joint.name:
            raise ValueError(f"joint {joint.name}: waits for itself")
        if by_name[name].type not in ("revolute", "prismatic") or by_name[name].mimic is not None:
            raise ValueError(
                f"joint {joint.name}: after takes revolute and prismatic joints that follow no "
                f"other, got {name}"
            )
        if name not in visited:
            visited.add(name)
            waiting += by_name[name].after


def require_known(subject: str, name: str, valid: Collection[str]) -> None:
    """Raise a ValueError that begins with `subject` if a name is not among the valid ones."""
    if name not in valid:
        raise ValueError(f"{subject}: {choices(name, sorted(valid))}")

"""Joints of an object: type, axis, limits, dynamics and intent."""

import math
from collections.abc import Collection
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from ..errors import choices
from .base import (
    Direction3,
    Name,
    NonNegative,
    Number,
    Point3,
    Positive,
    ScalableSpec,
    Vec3,
    unit_vector,
)
from .dimensions import ARMATURE, DAMPING, EFFORT, POSITION, RATIO, SPEED, STIFFNESS

JointType = Literal["fixed", "revolute", "continuous", "prismatic", "ball"]


def _is_empty(value: object) -> bool:
    return value is None or value == ()


class Mimic(ScalableSpec):
    """Relation of a joint to the joint that it follows: q = multiplier * q_other + offset."""

    joint: Name
    multiplier: Annotated[Number, RATIO] = 1.0
    offset: Annotated[Number, POSITION] = 0.0


class Intent(ScalableSpec):
    """Intended motion of a joint. Checks compare it with the actual motion; physics ignores it."""

    type: JointType | None = None
    opens: Direction3 | None = None
    """Initial direction in which the child moves when the joint value increases from 0."""
    travel: Annotated[Positive, POSITION] | None = None
    """Smallest useful range [rad or m]."""


class JointSpec(ScalableSpec):
    """A joint from `parent` to `child`.

    The anchor `pos` and the `axis` are in the object's frame with all joints at zero. Units are rad
    and N m for turning joints, and m and N for sliding joints. Positive motion turns the child
    about `axis` by the right-hand rule, or moves the child along `axis`. By convention, positive
    motion opens.

    A ball joint turns about `pos` in any direction. Its rotation angle is at most `upper`; if
    `upper` is 0, the angle is unlimited. A ball joint does not use the axis, lower limit, effort,
    velocity and mimic. Its position is a rotation vector along the object's axes, given as three
    values `<joint>.x`, `<joint>.y` and `<joint>.z` [rad].
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
    """Prerequisites: joints that must be fully open whenever this joint is away from 0, such as the
    door in front of a rack. Checks test the condition; physics ignores it."""
    intent: Intent | None = Field(default=None, exclude_if=_is_empty)

    @field_validator("axis")
    @classmethod
    def _unit(cls, value: Vec3) -> Vec3:
        return unit_vector(value)

    @model_validator(mode="after")
    def _ordered(self) -> "JointSpec":
        if self.type in ("revolute", "prismatic") and not self.lower < self.upper:
            raise ValueError(
                f"joint {self.name}: lower {self.lower} must be below upper {self.upper}"
            )
        if self.type == "ball":
            if self.lower != 0.0 or not 0.0 <= self.upper <= math.pi:
                raise ValueError(
                    f"joint {self.name}: a ball turns from 0 to at most pi (0 for no limit), "
                    f"got {self.lower} to {self.upper}"
                )
            if (self.mimic, self.effort, self.velocity) != (None, None, None):
                raise ValueError(f"joint {self.name}: a ball has no mimic, effort or velocity")
        return self


def check_prerequisites(joint: JointSpec, by_name: dict[str, JointSpec]) -> None:
    """Validate the prerequisites of a joint, listed in `after`.

    Raises:
        ValueError: the joint is fixed or mimics another joint, or a prerequisite is unknown, has no
            limits, mimics another joint, or has the joint itself as a prerequisite.
    """
    if joint.after and (joint.type == "fixed" or joint.mimic is not None):
        raise ValueError(f"joint {joint.name}: a fixed or mimic joint cannot use after")
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
    """Raise a ValueError that begins with `subject` if `name` is not one of the valid names."""
    if name not in valid:
        raise ValueError(f"{subject}: {choices(name, sorted(valid))}")

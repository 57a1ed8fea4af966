"""Base classes of host-side descriptions, and types of their fields."""

import math
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from ..io.names import RESERVED
from .dimensions import LENGTH, NO_JOINT, UNSCALED, Motion, Scaling, declared_scaling

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=48)]


def check_unreserved(name: str) -> str:
    """Return a name.

    Raises:
        ValueError: MuJoCo reserves the name.
    """
    if name in RESERVED:
        raise ValueError(f"MuJoCo reserves {name!r}, choose another name")
    return name


ObjectName = Annotated[Name, AfterValidator(check_unreserved)]
JointKey = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*(\.[xyz])?$", max_length=50)]
"""Key of a joint value: the name of a joint or, for a ball joint, NAME.x, NAME.y or NAME.z."""
MAX_LENGTH_M, MAX_NUMBER = 1e4, 1e9
"""Largest sizes of lengths and coordinates, and of other numbers. MuJoCo rejects states over 1e10,
and single precision resolves 1 mm at 10 km."""


def check_length(value: float) -> float:
    """Return a length or coordinate [m].

    Raises:
        ValueError: it is over `MAX_LENGTH_M` in size.
    """
    if abs(value) > MAX_LENGTH_M:
        raise ValueError(f"must be at most {MAX_LENGTH_M / 1e3:g} km")
    return value


def check_number(value: float) -> float:
    """Return a number.

    Raises:
        ValueError: it is over `MAX_NUMBER` in size.
    """
    if abs(value) > MAX_NUMBER:
        raise ValueError(f"must be at most {MAX_NUMBER:g}")
    return value


def unit_vector(value: tuple[float, ...]) -> tuple:
    """Return a vector or quaternion divided by its length.

    Raises:
        ValueError: the vector is zero.
    """
    length = math.sqrt(sum(v * v for v in value))
    if length < 1e-9:
        raise ValueError("must not be zero")
    if abs(length - 1.0) < 1e-12:
        return value
    return tuple(v / length for v in value)


Number = Annotated[float, Field(allow_inf_nan=False), AfterValidator(check_number)]
NonNegative = Annotated[float, Field(ge=0), AfterValidator(check_number)]
Positive = Annotated[float, Field(gt=0), AfterValidator(check_number)]
Meters = Annotated[float, Field(allow_inf_nan=False), AfterValidator(check_length)]
"""A coordinate [m]."""
Length = Annotated[float, Field(gt=0, allow_inf_nan=False), AfterValidator(check_length), LENGTH]
Vec3 = tuple[Number, Number, Number]
Quat = Annotated[tuple[Number, Number, Number, Number], AfterValidator(unit_vector)]
"""Quaternion (w, x, y, z), which is normalized."""
Point3 = Annotated[tuple[Meters, Meters, Meters], LENGTH]
"""A point in the object's frame [m]."""
Direction3 = Annotated[Vec3, UNSCALED]
Rotation = Annotated[Quat, UNSCALED]


class Spec(BaseModel):
    """Base of all descriptions: immutable and convertible to JSON; unknown keys are rejected."""

    model_config = ConfigDict(extra="forbid", frozen=True)


_Scalable = TypeVar("_Scalable", bound="ScalableSpec")


class ScalableSpec(Spec):
    """Base of the descriptions that make up an object: every numeric field declares its scaling.

    Defining a subclass raises a TypeError if the annotation of a numeric field lacks a `Scaling`.
    """

    scalings: ClassVar[dict[str, Scaling | None]] = {}
    """Scaling of each field; None for a field that holds no numbers itself. Nested descriptions
    declare the scalings of their fields."""

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Collect the scalings of all fields."""
        super().__pydantic_init_subclass__(**kwargs)
        cls.scalings = {}
        for name, field in cls.model_fields.items():
            try:
                cls.scalings[name] = declared_scaling(field.annotation, field.metadata)
            except TypeError as error:
                raise TypeError(f"{cls.__name__}.{name} {error}") from None

    def scaled(self: _Scalable, s: float, motion: Motion = NO_JOINT) -> _Scalable:
        """Return a copy with each number multiplied by the power of `s` that its field declares."""
        update: dict[str, object] = {}
        for name, scaling in self.scalings.items():
            value = getattr(self, name)
            if scaling is None:
                update[name] = _scaled_parts(value, s, motion)
            elif power := scaling.exponent(motion):
                update[name] = _times(value, s**power)
        return self.model_copy(update=update)


def _scaled_parts(value: Any, s: float, motion: Motion) -> Any:
    if isinstance(value, tuple):
        return tuple(_scaled_parts(item, s, motion) for item in value)
    return value.scaled(s, motion) if isinstance(value, ScalableSpec) else value


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_times(item, factor) for item in value)
    return None if value is None else value * factor

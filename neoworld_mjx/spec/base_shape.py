"""What all shapes have in common: closed fields, convex pieces, and one way to be scaled."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field

from .convex import Piece

Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Point2 = tuple[Number, Number]
Point3 = tuple[Number, Number, Number]
Face = Literal["+x", "-x", "+y", "-y", "+z", "-z"]

MIN_SECTORS, MAX_SECTORS = 6, 64


class BaseShape(BaseModel):
    """Base of all shapes: frozen, closed against unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    unscaled: ClassVar[tuple[str, ...]] = ("type", "sectors", "open", "closed", "oval")
    """Fields that are no lengths."""

    def pieces(self) -> list[Piece]:
        """Return the convex pieces, in the shape's frame."""
        raise NotImplementedError

    def scaled(self, s: float) -> Self:
        """Return the shape with every length multiplied by `s`."""
        lengths = {
            name: _times(getattr(self, name), s)
            for name in type(self).model_fields
            if name not in self.unscaled
        }
        return self.model_copy(update=lengths)


def _times(value: object, s: float) -> object:
    if isinstance(value, tuple):
        return tuple(_times(item, s) for item in value)
    return value * s if isinstance(value, int | float) else value

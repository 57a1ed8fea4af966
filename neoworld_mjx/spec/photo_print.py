"""A print of the photograph on a material."""

from typing import Annotated

from pydantic import Field

from .base import ScalableSpec, Vec3
from .dimensions import UNSCALED, Dimension, Scaling

PER_LENGTH = Scaling(Dimension(length=-1))
Encoded = Annotated[str, Field(max_length=4_000_000, pattern=r"^[A-Za-z0-9+/]*={0,2}$")]
Row = Annotated[Vec3, PER_LENGTH]


class PhotoPrint(ScalableSpec):
    """A window of the photograph, projected onto the surfaces that its camera saw.

    A point p of the object's frame at rest [m] lies at (turn p + shift) = (u w, v w, w): u to the
    right and v down in the window, both from 0 to 1, and w its depth. The camera saw the point if w
    equals the window's depth there. The colours include the lighting of the photograph.
    """

    image: Encoded
    """Window of the photograph: PNG in base64; inpainted where others occluded the object."""
    depth: Encoded
    """Depths: PNG of 16 bits in base64; 0 where not visible, otherwise near to far."""
    near: Annotated[float, Field(gt=0, allow_inf_nan=False), UNSCALED]
    """Depth that the value 1 encodes [m of the photographed scene]."""
    far: Annotated[float, Field(gt=0, allow_inf_nan=False), UNSCALED]
    """Depth that the value 65535 encodes."""
    turn: tuple[Row, Row, Row]
    """[1/m]"""
    shift: Annotated[Vec3, UNSCALED]

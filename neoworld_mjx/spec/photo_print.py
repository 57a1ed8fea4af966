"""A print of the photograph on a material."""

from typing import Annotated

from pydantic import Field

from .base import ScalableSpec, Vec3
from .dimensions import UNSCALED, Dimension, Scaling

PER_LENGTH = Scaling(Dimension(length=-1))
Encoded = Annotated[str, Field(max_length=4_000_000, pattern=r"^[A-Za-z0-9+/]*={0,2}$")]
Row = Annotated[Vec3, PER_LENGTH]


class PhotoPrint(ScalableSpec):
    """A window of the photograph, projected on what faced the camera and was not covered.

    A point p of the object's frame at rest [m] lies at (turn p + shift) = (u w, v w, w): u to the
    right and v down in the window, both from 0 to 1, and w its depth. It was seen where the depth
    of the window there is w. The light of the photograph is in the colours.
    """

    image: Encoded
    """Window of the photograph: PNG in base64; inpainted where others occluded the object."""
    depth: Encoded
    """Depths: PNG of 16 bits in base64; 0 where not visible, otherwise near to far."""
    near: Annotated[float, Field(gt=0, allow_inf_nan=False), UNSCALED]
    """Depth of a 1 [m of the photographed scene]."""
    far: Annotated[float, Field(gt=0, allow_inf_nan=False), UNSCALED]
    """Depth of a 65535."""
    turn: tuple[Row, Row, Row]
    """[1/m]"""
    shift: Annotated[Vec3, UNSCALED]

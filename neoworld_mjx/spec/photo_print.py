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

    A point p in the object's frame with all joints at zero [m] has the window coordinates u and v
    and the depth w, where turn p + shift = (u w, v w, w). In the window, u points to the right and
    v points down, both from 0 to 1. The camera saw the point if w equals the depth of the window at
    (u, v). The colors include the lighting of the photograph.
    """

    image: Encoded
    """Window of the photograph, as base64 of a PNG; inpainted where other objects occluded the
    object."""
    depth: Encoded
    """Depths, as base64 of a 16-bit PNG: 0 where the object is not visible, otherwise 1 (near) to
    65535 (far)."""
    near: Annotated[float, Field(gt=0, allow_inf_nan=False), UNSCALED]
    """Depth that the value 1 encodes [m], in the photographed scene; scaling does not change it."""
    far: Annotated[float, Field(gt=0, allow_inf_nan=False), UNSCALED]
    """Depth that the value 65535 encodes [m]."""
    turn: tuple[Row, Row, Row]
    """Matrix of the projection, by rows [1/m]."""
    shift: Annotated[Vec3, UNSCALED]

"""Further photographs of a scene, with the 2D boxes of its objects."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, UInt8

from ..spec import Box2D


@dataclass(frozen=True)
class FurtherPhoto:
    """A further photograph of the scene, of any size."""

    photo: UInt8[np.ndarray, "row column 3"] = field(repr=False)
    """The photograph (sRGB), undistorted."""
    boxes: Mapping[str, Box2D] = field(default_factory=dict)
    """2D boxes of objects by name, in pixels of `photo`; if empty, a model is asked for them."""
    focal: float | None = None
    """Focal length in pixels of `photo`; None if the camera of the first photograph took it, and
    shows an image of the same view angle."""
    principal: tuple[float, float] = (0.0, 0.0)
    """Principal point relative to the middle of the image, to the right and down [px]."""
    to_first: Float[np.ndarray, "4 4"] | None = None
    """Rigid transform from the frame of this photograph's camera to that of the first one (OpenCV)
    [m]; None if it is unknown."""
    metric: bool = True
    """False if the unit of `to_first` is unknown."""
    source: str = ""
    """Name of the photograph, for messages."""

    def phrase(self) -> str:
        """Return what is known of the photograph in one line."""
        lens = "the first camera's field of view" if self.focal is None else "its own focal length"
        pose = "unknown pose" if self.to_first is None else "known pose"
        if self.to_first is not None and not self.metric:
            pose += " in an unknown unit"
        boxes = f"{len(self.boxes)} boxes" if self.boxes else "boxes by a model"
        return f"{self.source} ({lens}, {pose}, {boxes})"

"""A depth image of the photograph's view."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

DepthKind = Literal["metric", "affine", "disparity"]
"""Relation of the values of a depth image to the depth z along the view [m].

- metric: they are z.
- affine: z = scale * value + shift, with unknown scale and shift.
- disparity: 1 / z = scale * value + shift, with unknown scale and shift.
"""
SENSOR_M, SENSOR_PER_M = 0.0015, 0.002
"""Standard deviation of a depth sensor: a constant [m], and a coefficient of z^2 [1/m]."""
MONOCULAR = 0.03
"""Standard deviation of the smooth errors of a monocular network, relative to the depth."""


@dataclass(frozen=True)
class DepthImage:
    """A depth image of the same view as the photograph, at any size."""

    values: Float[np.ndarray, "row column"] = field(repr=False)
    """Values of `kind`; NaN where there is none."""
    kind: DepthKind = "metric"
    confidence: Float[np.ndarray, "row column"] | None = field(default=None, repr=False)
    """Confidence from 0 to 1; None if all values are equally certain."""
    smooth_sd: float = 0.0
    """Standard deviation of errors that neighboring pixels share, relative to the depth."""
    source: str = ""
    """Source of the values, for messages."""

    def resized(self, height: int, width: int) -> "DepthImage":
        """Return the image at another size, with the value of the nearest pixel.

        Averages across an edge would be depths at which nothing is.
        """
        pick = nearest_pixels(self.values.shape, height, width)
        confidence = None if self.confidence is None else self.confidence[pick]
        return DepthImage(self.values[pick], self.kind, confidence, self.smooth_sd, self.source)


def nearest_pixels(shape: tuple[int, ...], height: int, width: int) -> tuple[NDArray, NDArray]:
    """Return the index of the nearest pixels with which an image of `shape` is resized."""
    rows, columns = (
        np.minimum(((np.arange(n) + 0.5) * old / n).astype(int), old - 1)
        for n, old in zip((height, width), shape, strict=True)
    )
    return rows[:, None], columns[None]


def sensor_sd(depth: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return the standard deviation of a sensor's depths [m]."""
    return SENSOR_M + SENSOR_PER_M * depth**2

"""Correlations between the estimated poses and sizes of a scene's objects, and its camera."""

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from .base import Name, NonNegative, Number, Spec

EACH = 4
"""Number of values of the camera, and of each object."""


class PoseCorrelation(Spec):
    """Correlations that remain after alignment with the photograph.

    The values are pitch, roll, log focal length and log height of the camera, and then of each
    object the four quantities of its `PoseUncertainty`: along, across, yaw and log scale.
    """

    objects: tuple[Name, ...] = ()
    camera: tuple[NonNegative, NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0, 0.0)
    """Standard deviations of the camera's values [rad, rad, 1, 1]."""
    lower: tuple[Number, ...] = Field(default=(), repr=False)
    """Correlations below the diagonal, row by row."""

    @model_validator(mode="after")
    def _complete(self) -> "PoseCorrelation":
        size = EACH * (1 + len(self.objects))
        if self.objects and len(self.lower) != size * (size - 1) // 2:
            raise ValueError(
                f"correlation: {len(self.objects)} objects need {size * (size - 1) // 2} values "
                f"below the diagonal, got {len(self.lower)}"
            )
        if any(abs(value) > 1 for value in self.lower):
            raise ValueError("correlation: values must be from -1 to 1")
        return self

    @classmethod
    def of(
        cls, objects: tuple[str, ...], covariance: Float[np.ndarray, "value value"]
    ) -> "PoseCorrelation":
        """Return the correlations of a covariance; values without variance are uncorrelated."""
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        safe = np.where(deviation > 0, deviation, np.inf)
        correlation = np.clip(covariance / np.outer(safe, safe), -1.0, 1.0)
        rows, columns = np.tril_indices(len(deviation), -1)
        lower = np.round(correlation[rows, columns], 4) + 0.0
        pitch, roll, focal, height = (float(f"{value:.4g}") for value in deviation[:EACH])
        camera = (pitch, roll, focal, height)
        return cls(objects=objects, camera=camera, lower=tuple(lower.tolist()))

    def matrix(self) -> Float[np.ndarray, "value value"]:
        """Return the symmetric matrix of all correlations."""
        size = EACH * (1 + len(self.objects))
        correlation = np.eye(size)
        rows, columns = np.tril_indices(size, -1)
        correlation[rows, columns] = correlation[columns, rows] = self.lower
        return correlation

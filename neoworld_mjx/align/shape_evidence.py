"""Evidence of a contour about an object's proportions: Gaussian, in the logarithms of three
stretches along the object's axes.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

UNEXPLAINED = 0.01
"""Standard deviation of the stretches of a shape whose dimensions are right: shapes are
approximate."""
CHANGE = 0.1
"""Standard deviation of the logarithm of a dimension that is wrong."""


class DimensionChange(NamedTuple):
    """Estimate of the change of one dimension that explains a contour best."""

    log_change: float
    deviation: float
    log_odds: float
    """Log likelihood ratio of a shape with this dimension wrong and one that is right [nats]."""


class ShapeEvidence(NamedTuple):
    """Likelihood of the logarithms of an object's stretches, all other unknowns marginalized."""

    precision: Float[np.ndarray, "3 3"]
    information: Float[np.ndarray, " 3"]
    """Precision times the most probable stretches."""
    response: Float[np.ndarray, "u 3"]
    """Derivatives of the most probable values of the alignment's unknowns with respect to the
    log stretches."""
    discarded: Float[np.ndarray, " 3"]
    """Stretches that the alignment estimated and discarded, with their narrow prior."""

    def change(self, direction: Float[np.ndarray, " 3"]) -> DimensionChange:
        """Estimate the change of a dimension.

        Args:
            direction: derivatives of the log stretches with respect to the log of the dimension.
        """
        # The stretches that nothing explains are marginalized.
        noise = np.eye(3) + UNEXPLAINED**2 * self.precision
        precision = float(direction @ np.linalg.solve(noise, self.precision) @ direction)
        information = float(direction @ np.linalg.solve(noise, self.information))
        total = precision + 1 / CHANGE**2
        log_odds = 0.5 * information**2 / total - 0.5 * math.log(CHANGE**2 * total)
        return DimensionChange(information / total, total**-0.5, log_odds)

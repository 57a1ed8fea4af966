"""Contour evidence about an object's proportions, as a Gaussian in its three log stretches."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

UNEXPLAINED = 0.01
"""Standard deviation of the log stretches of a shape whose dimensions are right, because shapes are
approximate."""
CHANGE = 0.1
"""Standard deviation of the log change of a dimension that is wrong."""


class DimensionChange(NamedTuple):
    """Estimated change of one dimension that explains a contour best."""

    log_change: float
    deviation: float
    log_odds: float
    """Log likelihood ratio [nats] of a shape in which this dimension is wrong versus a shape that
    is right."""


class ShapeEvidence(NamedTuple):
    """Likelihood of an object's log stretches, with all other unknowns marginalized."""

    precision: Float[np.ndarray, "3 3"]
    information: Float[np.ndarray, " 3"]
    """`precision` @ the most probable log stretches."""
    response: Float[np.ndarray, "u 3"]
    """Derivatives of the most probable values of the alignment's unknowns with respect to the
    log stretches."""
    discarded: Float[np.ndarray, " 3"]
    """Log stretches that the alignment estimated with a narrow prior and discarded."""

    def change(self, direction: Float[np.ndarray, " 3"]) -> DimensionChange:
        """Estimate the change of a dimension.

        Args:
            direction: derivatives of the log stretches with respect to the log of the dimension.
        """
        # Stretches that no dimension explains are marginalized.
        noise = np.eye(3) + UNEXPLAINED**2 * self.precision
        precision = float(direction @ np.linalg.solve(noise, self.precision) @ direction)
        information = float(direction @ np.linalg.solve(noise, self.information))
        total = precision + 1 / CHANGE**2
        log_odds = 0.5 * information**2 / total - 0.5 * math.log(CHANGE**2 * total)
        return DimensionChange(information / total, total**-0.5, log_odds)

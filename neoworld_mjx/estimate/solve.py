"""Normal equations of the estimate: the sum of all rows, its solution and its covariance."""

from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Float, Int

from .rows.contacts import ContactGaps
from .rows.linear import LinearEvidence
from .unknowns import Unknowns

GIVEN = 1e18
"""Precision of an unknown whose value is given."""
ACTIVE_SETS = 10
"""Largest number of updates of the active set, the contacts that a step would violate."""


GLOBAL_PRECISION = 1e-6
"""Prior precision of the scale and shift of a depth image, which its own rows determine."""
Source = Literal["box", "contour", "depth"]
"""Source of the evidence of an object: its 2D box, its contour or a depth image."""


class NormalEquations:
    """Normal equations of the unknowns, all stretches, and a depth image's scale and shift."""

    def __init__(
        self,
        unknowns: Unknowns,
        prior: Float[np.ndarray, "v v"],
        x: Float[np.ndarray, " u"],
        *,
        mean: Float[np.ndarray, " u"],
        global_count: int = 0,
    ):
        """Start from the prior's precision matrix, at the values `x` of the unknowns.

        Args:
            unknowns: the unknowns.
            prior: precision of all unknowns and stretches.
            x: values of the unknowns.
            mean: mean of the prior.
            global_count: number of unknowns of the depth image, which follow the stretches.
        """
        self._unknowns, self._x = unknowns, x
        if global_count:
            prior = np.pad(prior, (0, global_count))
            ends = np.arange(len(prior) - global_count, len(prior))
            prior[ends, ends] = GLOBAL_PRECISION
        self._prior, self._precision = prior, prior.copy()
        self._gradient = -prior[:, : unknowns.size] @ (x - mean)
        self.shown: dict[Source, set[int]] = {source: set() for source in get_args(Source)}
        """Indices of the objects with evidence of each source, fixed supports included."""
        self._contacts = ContactGaps(np.zeros(0), np.zeros((0, len(prior))), np.zeros(0))

    def add(self, source: Source, k: int, evidence: LinearEvidence) -> None:
        """Add the evidence of an object."""
        self.shown[source].add(k)
        self._add(self._block(k, evidence))

    def add_camera(
        self, residual: Float[np.ndarray, " n"], jacobian: Float[np.ndarray, "n 4"]
    ) -> None:
        """Add evidence about the camera; residuals and Jacobian are in standard deviations."""
        camera = np.arange(jacobian.shape[1])
        block = _Block(camera, jacobian.T @ jacobian, jacobian.T @ residual)
        self._add(block)

    def add_contacts(self, contacts: ContactGaps) -> None:
        """Set the gaps between objects; `solved` penalizes steps that would make a gap negative."""
        more = len(self._prior) - contacts.jacobian.shape[1]
        if more:
            contacts = contacts._replace(jacobian=np.pad(contacts.jacobian, ((0, 0), (0, more))))
        self._contacts = contacts

    def solved(self) -> Float[np.ndarray, " u"]:
        """Return new values of the unknowns; known values stay 0."""
        precision, gradient = self._precision.copy(), self._gradient.copy()
        known = list(self._unknowns.known)
        precision[known, known] += GIVEN
        gradient[known] -= GIVEN * self._x[known]
        x = self._x + self._separated(precision, gradient)[: len(self._x)]
        x[known] = 0.0
        return x

    def _separated(self, precision: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Return the solution with a penalty on every gap that would otherwise be negative."""
        step = np.linalg.solve(precision, gradient)
        gap, jacobian, weight = self._contacts
        violated = np.zeros(len(gap), bool)
        for _ in range(ACTIVE_SETS):
            more = (gap + jacobian @ step < 0) & ~violated
            if not more.any():
                break
            violated |= more
            rows = jacobian[violated]
            weighted = rows.T * weight[violated]
            step = np.linalg.solve(precision + weighted @ rows, gradient - weighted @ gap[violated])
        return step

    def covariance(self) -> Float[np.ndarray, "u u"]:
        """Return the covariance of the unknowns; contacts are ignored."""
        return np.linalg.inv(self._precision)[: len(self._x), : len(self._x)]

    def _block(self, k: int, evidence: LinearEvidence) -> "_Block":
        size = len(self._x)
        used = np.flatnonzero((evidence.jacobian[:, :size] != 0).any(axis=0))
        stretches = self._unknowns.stretch_columns(k) if k in self._unknowns.free else []
        rows = np.concatenate([used, stretches]).astype(int)
        jacobian = evidence.jacobian[:, np.concatenate([used, size + np.arange(len(stretches))])]
        if evidence.global_jacobian is not None:
            count = evidence.global_jacobian.shape[1]
            rows = np.append(rows, np.arange(len(self._prior) - count, len(self._prior)))
            jacobian = np.concatenate([jacobian, evidence.global_jacobian], axis=1)
        weighted = jacobian * evidence.weight[:, None]
        return _Block(rows, jacobian.T @ weighted, weighted.T @ evidence.residual)

    def _add(self, block: "_Block") -> None:
        self._precision[np.ix_(block.rows, block.rows)] += block.precision
        self._gradient[block.rows] += block.gradient


class _Block(NamedTuple):
    rows: Int[np.ndarray, " r"]
    precision: Float[np.ndarray, "r r"]
    gradient: Float[np.ndarray, " r"]

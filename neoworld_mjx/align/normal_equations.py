"""Normal equations of the alignment, from the prior, the linearized evidence, and contacts."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .contacts import ContactGaps
from .linear_evidence import LinearEvidence
from .shape_evidence import ShapeEvidence
from .unknowns import STRETCH, Unknowns

OVERLAP_M = 0.002
"""Standard deviation of the overlap of two objects [m]."""
DEEP_M = 0.005
"""Overlap at which the weight of a contact is halved [m]. Deeper overlaps are probably due to wrong
shapes."""
GIVEN = 1e18
"""Precision of an unknown whose value is given."""
ACTIVE_SETS = 10
"""Largest number of updates of the active set, the contacts that a step would violate."""


class NormalEquations:
    """Normal equations of the unknowns and of all stretches.

    The contour evidence is stored by object, so that `solved` can omit it.
    """

    def __init__(
        self, unknowns: Unknowns, prior: Float[np.ndarray, "v v"], x: Float[np.ndarray, " u"]
    ):
        """Start from the prior's precision matrix, at the values `x` of the unknowns."""
        self._unknowns, self._x = unknowns, x
        self._prior, self._precision = prior, prior.copy()
        self._gradient = -prior[:, : unknowns.size] @ x
        self._contours: dict[int, _Block] = {}
        self._boxes: set[int] = set()
        self._contacts = ContactGaps(np.zeros(0), np.zeros((0, len(prior))))

    def add_box(self, k: int, evidence: LinearEvidence) -> None:
        """Add the evidence of an object's 2D box."""
        self._boxes.add(k)
        self._add(self._block(k, evidence), 1.0, self._precision, self._gradient)

    def add_camera(
        self, residual: Float[np.ndarray, " n"], jacobian: Float[np.ndarray, "n 4"]
    ) -> None:
        """Add evidence about the camera; residuals and Jacobian are in standard deviations."""
        camera = np.arange(jacobian.shape[1])
        block = _Block(camera, jacobian.T @ jacobian, jacobian.T @ residual)
        self._add(block, 1.0, self._precision, self._gradient)

    def add_contacts(self, contacts: ContactGaps) -> None:
        """Set the gaps between objects; `solved` penalizes steps that would make a gap negative."""
        self._contacts = contacts

    def add_contour(self, k: int, evidence: LinearEvidence) -> None:
        """Add the evidence of an object's contour, which `solved` can omit."""
        self._contours[k] = self._block(k, evidence)
        self._add(self._contours[k], 1.0, self._precision, self._gradient)

    @property
    def with_contour(self) -> tuple[int, ...]:
        """Indices of the objects with contour evidence."""
        return tuple(self._contours)

    @property
    def with_box(self) -> frozenset[int]:
        """Indices of the objects whose 2D boxes were added as evidence."""
        return frozenset(self._boxes)

    def solved(
        self, without: Collection[int] = (), held: Mapping[int, float] | None = None
    ) -> Float[np.ndarray, " u"]:
        """Return new values of the unknowns; joints stay within their limits.

        Args:
            without: indices of the objects whose contours are omitted.
            held: given values of unknowns, by index of the unknown.
        """
        precision, gradient = self._precision.copy(), self._gradient.copy()
        for k in without:
            self._add(self._contours[k], -1.0, precision, gradient)
        fixed = dict(held or {})
        first = self._unknowns.first_joint
        while True:
            x = self._x + self._separated(*self._fixed(precision, gradient, fixed))[: len(self._x)]
            x[list(fixed)] = list(fixed.values())
            limits = {
                first + j: limit
                for j, joint in enumerate(self._unknowns.joints)
                if (limit := joint.limit_beyond(x[first + j])) is not None
            }
            if not limits:
                return x
            fixed |= limits

    def _fixed(
        self, precision: np.ndarray, gradient: np.ndarray, values: Mapping[int, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the equations with some unknowns fixed at given values."""
        if not values:
            return precision, gradient
        columns = list(values)
        precision, gradient = precision.copy(), gradient.copy()
        precision[columns, columns] += GIVEN
        gradient[columns] += GIVEN * (np.array(list(values.values())) - self._x[columns])
        return precision, gradient

    def _separated(self, precision: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Return the solution with a penalty on every gap that would otherwise be negative."""
        step = np.linalg.solve(precision, gradient)
        gap, jacobian = self._contacts
        weight = 1 / (OVERLAP_M**2 * (1 + (np.minimum(gap, 0.0) / DEEP_M) ** 2))
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

    def shape_evidence(self) -> dict[int, ShapeEvidence]:
        """Return the evidence about the stretches of each object with contour evidence, by index.

        The evidence comes from contours and 2D boxes. All other unknowns are marginalized, and
        contacts are ignored.
        """
        covariance = np.linalg.inv(self._precision)
        estimate = covariance @ self._gradient
        found = {}
        for k in self.with_contour:
            # The first stretches are those of the object itself, not of the parts that its joints
            # move.
            rows = np.array(self._unknowns.stretch_columns(k)[:STRETCH])
            block = np.ix_(rows, rows)
            precision = np.linalg.inv(covariance[block])
            found[k] = ShapeEvidence(
                precision - self._prior[block],
                precision @ estimate[rows],
                covariance[: len(self._x), rows] @ precision,
                estimate[rows],
            )
        return found

    def _block(self, k: int, evidence: LinearEvidence) -> "_Block":
        size = len(self._x)
        used = np.flatnonzero((evidence.jacobian[:, :size] != 0).any(axis=0))
        stretches = self._unknowns.stretch_columns(k)
        rows = np.concatenate([used, stretches])
        jacobian = evidence.jacobian[:, np.concatenate([used, size + np.arange(len(stretches))])]
        weighted = jacobian * evidence.weight[:, None]
        return _Block(rows, jacobian.T @ weighted, weighted.T @ evidence.residual)

    @staticmethod
    def _add(block: "_Block", sign: float, precision: np.ndarray, gradient: np.ndarray) -> None:
        precision[np.ix_(block.rows, block.rows)] += sign * block.precision
        gradient[block.rows] += sign * block.gradient


class _Block(NamedTuple):
    rows: Int[np.ndarray, " r"]
    precision: Float[np.ndarray, "r r"]
    gradient: Float[np.ndarray, " r"]

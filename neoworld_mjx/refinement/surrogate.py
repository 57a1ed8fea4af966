"""Surrogate of the model's score for candidates without a score.

It predicts the difference between the model's score and the geometric one: its mean and, if
cross-validation on the scored candidates shows a gain, a ridge regression on the standardised
layout, its squares, and the geometric score. Without evidence the difference is zero, so that a few
scores hardly change the geometric score.
"""

import numpy as np
from numpy.typing import NDArray

LAMBDAS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Ridge penalties to try; features have about unit variance."""
FEWEST = 6
"""Scored candidates needed for a regression on layouts."""


def surrogate_scores(
    layouts: NDArray,
    geometric: NDArray,
    scored_layouts: NDArray,
    scored_geometric: NDArray,
    scores: NDArray,
) -> NDArray:
    """Estimate scores in [0, 1].

    The order of the scored candidates affects only rounding; callers sort them.

    Args:
        layouts: standardised layouts of the candidates, float [pop, number].
        geometric: their geometric scores [pop].
        scored_layouts: of the scored candidates, float [scored, number].
        scored_geometric: geometric scores of the scored candidates [scored].
        scores: the model's scores [scored].

    Returns:
        Estimates [pop]; the geometric scores where nothing is scored.
    """
    count = len(scores)
    geometric = np.asarray(geometric, float)
    if not count:
        return np.clip(geometric, 0.0, 1.0)
    difference = np.asarray(scores, float) - scored_geometric
    # Shrinkage of the mean, equivalent to one more candidate with difference zero.
    mean = difference.sum() / (count + 1)
    known, targets = _features(scored_layouts, scored_geometric), _features(layouts, geometric)
    center = known.mean(axis=0)
    predicted = _regressed(known - center, difference - mean, targets - center)
    return np.clip(geometric + mean + predicted, 0.0, 1.0)


def _features(layouts: NDArray, geometric: NDArray) -> NDArray:
    # Clipping at 3 deviations prevents extrapolation to outliers.
    z = np.clip(np.asarray(layouts, float), -3.0, 3.0)
    return np.concatenate([z, z**2 - 1.0, 5.0 * np.asarray(geometric, float)[:, None]], axis=1)


def _regressed(known: NDArray, residuals: NDArray, targets: NDArray) -> NDArray:
    """Predict residuals at `targets` by ridge regression, shrunk by its leave-one-out gain."""
    count = len(residuals)
    zeros = np.zeros(len(targets))
    if count < FEWEST or not np.any(residuals):
        return zeros
    # Principal axes, by the smaller of the two Gram matrices.
    wide = known.shape[1] > count
    eigenvalues, vectors = np.linalg.eigh(known @ known.T if wide else known.T @ known)
    significant = eigenvalues > 1e-9 * eigenvalues[-1]
    eigenvalues, vectors = eigenvalues[significant], vectors[:, significant]
    axes = known.T @ vectors / np.sqrt(eigenvalues) if wide else vectors
    along = known @ axes
    projected = along.T @ residuals
    base = float(np.mean(residuals**2))
    best, slopes = base, None
    for penalty in LAMBDAS:
        weight = 1.0 / (eigenvalues + penalty)
        # Leave-one-out residuals follow from the diagonal of the hat matrix.
        left_out = (residuals - along @ (weight * projected)) / (1.0 - (along**2) @ weight)
        error = float(np.mean(left_out**2))
        if error < best:
            best, slopes = error, axes @ (weight * projected)
    if slopes is None:
        return zeros
    return (1.0 - best / base) * (targets @ slopes)

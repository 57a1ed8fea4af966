"""Surrogate that estimates the model's score of candidates that the model has not scored.

The surrogate adds a predicted difference to the geometric score. The prediction is the mean
difference between the model's scores and the geometric scores of the scored candidates. If
cross-validation on these candidates shows a gain, a ridge regression is added, on the normalized
layout variables, the squares of these variables, and the geometric score. The mean is shrunk toward
zero, so a few scores hardly change the geometric scores.
"""

import numpy as np
from numpy.typing import NDArray

PENALTIES = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Ridge penalties that are tried. The variance of the features is about 1."""
MIN_SCORED = 6
"""Number of scored candidates that the regression requires."""


def surrogate_scores(
    layouts: NDArray,
    geometric: NDArray,
    scored_layouts: NDArray,
    scored_geometric: NDArray,
    scores: NDArray,
) -> NDArray:
    """Estimate the model's scores of candidates.

    The order of the scored candidates changes the estimates only by rounding. Callers sort the
    candidates to avoid this.

    Args:
        layouts: layout variables of the candidates, divided by their initial standard deviations;
            shape [pop, variable].
        geometric: geometric scores of the candidates; shape [pop].
        scored_layouts: normalized layout variables of the scored candidates; shape
            [scored, variable].
        scored_geometric: geometric scores of the scored candidates; shape [scored].
        scores: the model's scores of the scored candidates; shape [scored].

    Returns:
        Estimates in [0, 1], shape [pop]. If there are no scored candidates, these are the geometric
        scores.
    """
    count = len(scores)
    geometric = np.asarray(geometric, float)
    if not count:
        return np.clip(geometric, 0.0, 1.0)
    difference = np.asarray(scores, float) - scored_geometric
    # The mean is shrunk as if there were one more candidate, with a difference of zero.
    mean = difference.sum() / (count + 1)
    scored_features, targets = (
        _features(scored_layouts, scored_geometric),
        _features(layouts, geometric),
    )
    center = scored_features.mean(axis=0)
    predicted = _ridge_predictions(scored_features - center, difference - mean, targets - center)
    return np.clip(geometric + mean + predicted, 0.0, 1.0)


def _features(layouts: NDArray, geometric: NDArray) -> NDArray:
    # Clipping at 3 standard deviations prevents extrapolation to outliers.
    z = np.clip(np.asarray(layouts, float), -3.0, 3.0)
    return np.concatenate([z, z**2 - 1.0, 5.0 * np.asarray(geometric, float)[:, None]], axis=1)


def _ridge_predictions(scored_features: NDArray, residuals: NDArray, targets: NDArray) -> NDArray:
    """Predict residuals at `targets` by ridge regression, shrunk by its leave-one-out gain."""
    count = len(residuals)
    zeros = np.zeros(len(targets))
    if count < MIN_SCORED or not np.any(residuals):
        return zeros
    # Compute the principal axes from the smaller one of the two Gram matrices.
    wide = scored_features.shape[1] > count
    eigenvalues, vectors = np.linalg.eigh(
        scored_features @ scored_features.T if wide else scored_features.T @ scored_features
    )
    significant = eigenvalues > 1e-9 * eigenvalues[-1]
    eigenvalues, vectors = eigenvalues[significant], vectors[:, significant]
    axes = scored_features.T @ vectors / np.sqrt(eigenvalues) if wide else vectors
    along = scored_features @ axes
    projected = along.T @ residuals
    base = float(np.mean(residuals**2))
    best, slopes = base, None
    for penalty in PENALTIES:
        weight = 1.0 / (eigenvalues + penalty)
        # Leave-one-out residuals follow from the diagonal of the hat matrix.
        left_out = (residuals - along @ (weight * projected)) / (1.0 - (along**2) @ weight)
        error = float(np.mean(left_out**2))
        if error < best:
            best, slopes = error, axes @ (weight * projected)
    if slopes is None:
        return zeros
    return (1.0 - best / base) * (targets @ slopes)

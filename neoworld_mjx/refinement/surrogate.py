"""Surrogate of the model's score for candidates that it has not scored.

It predicts the difference between the model's score and the geometric one: its mean and, where the
scored candidates show that the layout predicts it, a ridge regression on the layout's standardised
numbers, their squares, and the geometric score. Without evidence the difference is zero, so that a
handful of scores leaves the geometric score as it is.
"""

import numpy as np
from numpy.typing import NDArray

LAMBDAS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Ridge penalties that are tried; features have about unit variance."""
FEWEST = 6
"""Scored candidates from which layouts are regressed on at all."""


def surrogate_scores(
    layouts: NDArray,
    geometric: NDArray,
    scored_layouts: NDArray,
    scored_geometric: NDArray,
    scores: NDArray,
) -> NDArray:
    """Estimate scores in [0, 1].

    The same scored candidates in another order give the same up to rounding; callers order them.

    Args:
        layouts: standardised layouts of the candidates, float [pop, number].
        geometric: their geometric scores [pop].
        scored_layouts: of the scored candidates, float [scored, number].
        scored_geometric: theirs [scored].
        scores: what the model gave them [scored].

    Returns:
        Estimates [pop]; the geometric scores where nothing is scored.
    """
    count = len(scores)
    geometric = np.asarray(geometric, float)
    if not count:
        return np.clip(geometric, 0.0, 1.0)
    difference = np.asarray(scores, float) - scored_geometric
    # As if one more candidate had been scored just as geometry scores it.
    mean = difference.sum() / (count + 1)
    known, wanted = _features(scored_layouts, scored_geometric), _features(layouts, geometric)
    centre = known.mean(axis=0)
    predicted = _regressed(known - centre, difference - mean, wanted - centre)
    return np.clip(geometric + mean + predicted, 0.0, 1.0)


def _features(layouts: NDArray, geometric: NDArray) -> NDArray:
    # An outlier must not be extrapolated to: 3 deviations are as far as candidates tell anything.
    z = np.clip(np.asarray(layouts, float), -3.0, 3.0)
    return np.concatenate([z, z**2 - 1.0, 5.0 * np.asarray(geometric, float)[:, None]], axis=1)


def _regressed(known: NDArray, rest: NDArray, wanted: NDArray) -> NDArray:
    """Predict `rest` at `wanted` by ridge regression, shrunk by its gain on left-out candidates."""
    count = len(rest)
    nothing = np.zeros(len(wanted))
    if count < FEWEST or not np.any(rest):
        return nothing
    # Principal axes, by the smaller of the two Gram matrices.
    wide = known.shape[1] > count
    square, turn = np.linalg.eigh(known @ known.T if wide else known.T @ known)
    kept = square > 1e-9 * square[-1]
    square, turn = square[kept], turn[:, kept]
    axes = known.T @ turn / np.sqrt(square) if wide else turn
    along = known @ axes
    projected = along.T @ rest
    base = float(np.mean(rest**2))
    best, slopes = base, None
    for penalty in LAMBDAS:
        weight = 1.0 / (square + penalty)
        # The residual of a candidate that is left out follows from the hat matrix's diagonal.
        out = (rest - along @ (weight * projected)) / (1.0 - (along**2) @ weight)
        error = float(np.mean(out**2))
        if error < best:
            best, slopes = error, axes @ (weight * projected)
    if slopes is None:
        return nothing
    return (1.0 - best / base) * (wanted @ slopes)

"""Estimates for candidates that no model has scored, from those that one has.

What is estimated is by how much the model's score departs from the geometric one: a mean departure, and
where the scored candidates show that it can be told from the layout, a ridge regression on the
layout's standardised numbers, their squares, and the geometric score. Without evidence the departure
is zero, so that few scores leave the geometric score as it is.
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
    departure = np.asarray(scores, float) - scored_geometric
    # As if one more candidate had been scored just as geometry scores it.
    mean = departure.sum() / (count + 1)
    known, asked = _features(scored_layouts, scored_geometric), _features(layouts, geometric)
    centre = known.mean(axis=0)
    told = _regressed(known - centre, departure - mean, asked - centre)
    return np.clip(geometric + mean + told, 0.0, 1.0)


def _features(layouts: NDArray, geometric: NDArray) -> NDArray:
    # An outlier must not be extrapolated to: 3 deviations are as far as candidates tell anything.
    z = np.clip(np.asarray(layouts, float), -3.0, 3.0)
    return np.concatenate([z, z**2 - 1.0, 5.0 * np.asarray(geometric, float)[:, None]], axis=1)


def _regressed(known: NDArray, rest: NDArray, asked: NDArray) -> NDArray:
    """Predict `rest` at `asked` by ridge regression, shrunk by what it saves on candidates left out."""
    count = len(rest)
    nothing = np.zeros(len(asked))
    if count < FEWEST or not np.any(rest):
        return nothing
    # Principal axes, by the smaller of the two Gram matrices.
    wide = known.shape[1] > count
    square, turn = np.linalg.eigh(known @ known.T if wide else known.T @ known)
    kept = square > 1e-9 * square[-1]
    square, turn = square[kept], turn[:, kept]
    axes = known.T @ turn / np.sqrt(square) if wide else turn
    along = known @ axes
    seen = along.T @ rest
    base = float(np.mean(rest**2))
    best, slopes = base, None
    for penalty in LAMBDAS:
        weight = 1.0 / (square + penalty)
        # The residual of a candidate that is left out follows from the hat matrix's diagonal.
        out = (rest - along @ (weight * seen)) / (1.0 - (along**2) @ weight)
        error = float(np.mean(out**2))
        if error < best:
            best, slopes = error, axes @ (weight * seen)
    if slopes is None:
        return nothing
    return (1.0 - best / base) * (asked @ slopes)

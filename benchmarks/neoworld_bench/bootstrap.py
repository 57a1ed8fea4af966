"""Bootstrap intervals of ratios, resampled by group."""

from collections.abc import Iterable

import numpy as np

DRAWS, LEVEL = 2000, 0.95
"""Bootstrap draws, and the level of the interval."""

Interval = tuple[float | None, float | None, float | None]
"""Mean, low and high; None if undefined."""


def ratio_interval(parts: Iterable[tuple[str, float, float]], draws: int = DRAWS) -> Interval:
    """Return sum over count of parts, with a bootstrap interval over groups of parts.

    Args:
        parts: group, such as a scene, sum and count of each part.
        draws: number of resamples; 0 returns no interval. Resamples with a count of 0 are dropped.
    """
    totals: dict[str, list[float]] = {}
    for group, amount, count in parts:
        total = totals.setdefault(group, [0.0, 0.0])
        total[0] += amount
        total[1] += count
    sums, counts = np.array([totals[group] for group in sorted(totals)]).reshape(-1, 2).T
    if not counts.sum():
        return None, None, None
    mean = float(sums.sum() / counts.sum())
    if not draws:
        return mean, None, None
    drawn = np.random.default_rng(0).integers(len(sums), size=(draws, len(sums)))
    sums, counts = sums[drawn].sum(axis=1), counts[drawn].sum(axis=1)
    means = sums[counts > 0] / counts[counts > 0]
    low, high = np.quantile(means, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return mean, float(low), float(high)

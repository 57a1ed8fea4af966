"""Means, rates, paired differences and ratios with 95 % intervals."""

import math
import warnings
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

LEVEL = 0.95
DRAWS = 2000
"""Number of bootstrap resamples."""


class Estimate(NamedTuple):
    """Mean or rate with its interval; NaN where there are too few values."""

    mean: float
    low: float
    high: float
    n: int


UNKNOWN = Estimate(math.nan, math.nan, math.nan, 0)


def rate(hits: Sequence[bool]) -> Estimate:
    """Estimate a rate with Wilson's score interval."""
    n, k = len(hits), sum(map(bool, hits))
    if n == 0:
        return UNKNOWN
    low, high = stats.binomtest(k, n).proportion_ci(LEVEL, method="wilson")
    return Estimate(k / n, float(low), float(high), n)


def mean(values: Sequence[float]) -> Estimate:
    """Estimate a mean with Student's t interval, which is NaN for fewer than two values."""
    n = len(values)
    if n == 0:
        return UNKNOWN
    center = float(np.mean(values))
    if n == 1:
        return Estimate(center, math.nan, math.nan, n)
    low, high = center + stats.sem(values) * np.array(stats.t.interval(LEVEL, n - 1))
    return Estimate(center, float(low), float(high), n)


def rate_difference(hits: Sequence[bool], others: Sequence[bool]) -> Estimate:
    """Estimate the difference of two paired rates with Agresti and Min's adjusted Wald interval.

    Half an observation is added to each of the four outcomes of a pair, so that the interval has
    nonzero width even if all pairs agree. `mean` is the plain difference.

    Args:
        hits: first outcome of each pair.
        others: second outcome of each pair, which is subtracted.
    """
    n = len(hits)
    if n == 0:
        return UNKNOWN
    differences = np.asarray(hits, int) - np.asarray(others, int)
    net, discordant = int(differences.sum()), int(np.abs(differences).sum())
    adjusted_n = n + 2.0
    center = net / adjusted_n
    variance = max((discordant + 1.0) / adjusted_n - center**2, 0.0) / adjusted_n
    half = float(stats.norm.ppf((1 + LEVEL) / 2)) * math.sqrt(variance)
    return Estimate(net / n, max(-1.0, center - half), min(1.0, center + half), n)


Interval = tuple[float | None, float | None, float | None]
"""Mean, low and high; None if undefined."""


def ratio_interval(parts: Iterable[tuple[str, float, float]], draws: int = DRAWS) -> Interval:
    """Return sum over count of parts, with a bootstrap interval over groups of parts.

    Args:
        parts: group, such as a scene, sum and count of each part.
        draws: number of resamples; 0 returns no interval. Resamples with a count of 0 are dropped.
    """
    totals: dict[str, np.ndarray] = {}
    for group, *part in parts:
        totals[group] = totals.get(group, np.zeros(2)) + part
    sums, counts = np.array([totals[group] for group in sorted(totals)]).reshape(-1, 2).T
    if not counts.sum():
        return None, None, None
    mean = float(sums.sum() / counts.sum())
    if not draws:
        return mean, None, None
    if len(sums) == 1:
        return mean, mean, mean
    with warnings.catch_warnings():
        # Dropped resamples are NaN, for which SciPy has no interval.
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        resampled = stats.bootstrap(
            (sums, counts),
            _ratio,
            n_resamples=draws,
            paired=True,
            vectorized=True,
            method="percentile",
            rng=np.random.default_rng(0),
        ).bootstrap_distribution
    low, high = np.nanquantile(resampled, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return mean, float(low), float(high)


def _ratio(sums: np.ndarray, counts: np.ndarray, axis: int) -> np.ndarray:
    total = counts.sum(axis=axis)
    return np.divide(sums.sum(axis=axis), total, where=total > 0, out=np.full(total.shape, np.nan))

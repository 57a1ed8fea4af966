"""Means and rates with 95 % intervals, of runs and of paired differences."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

Z = float(stats.norm.ppf(0.975))


class Estimate(NamedTuple):
    """A mean or a rate with its 95 % interval; NaN where there are too few values."""

    mean: float
    low: float
    high: float
    n: int


def rate(hits: Sequence[bool]) -> Estimate:
    """Estimate a rate: Wilson's score interval, which holds at 0 and 1 too."""
    n = len(hits)
    if n == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    p = sum(map(bool, hits)) / n
    middle = (p + Z * Z / (2 * n)) / (1 + Z * Z / n)
    half = Z / (1 + Z * Z / n) * math.sqrt(p * (1 - p) / n + Z * Z / (4 * n * n))
    return Estimate(p, max(0.0, middle - half), min(1.0, middle + half), n)


def mean(values: Sequence[float]) -> Estimate:
    """Estimate a mean by Student's t; its interval is unknown (NaN) for fewer than two values."""
    x = np.asarray(values, float)
    n = len(x)
    if n < 2:
        return Estimate(float(x.mean()) if n else math.nan, math.nan, math.nan, n)
    half = float(stats.t.ppf(0.975, n - 1)) * float(x.std(ddof=1)) / math.sqrt(n)
    centre = float(x.mean())
    return Estimate(centre, centre - half, centre + half, n)


def rate_difference(hits: Sequence[bool], others: Sequence[bool]) -> Estimate:
    """Estimate the difference of two rates over pairs: Agresti and Min's adjusted Wald interval.

    Half an observation is added to each of the four outcomes of a pair, so that the interval has a
    width also where all pairs agree. `mean` is the plain difference.

    Args:
        hits: first outcome of each pair.
        others: second outcome of each pair, subtracted.
    """
    n = len(hits)
    if n == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    gained = sum(bool(a) and not b for a, b in zip(hits, others, strict=True))
    lost = sum(bool(b) and not a for a, b in zip(hits, others, strict=True))
    adjusted_n = n + 2.0
    centre = (gained - lost) / adjusted_n
    spread = (gained + lost + 1.0) / adjusted_n - centre**2
    half = Z * math.sqrt(max(spread, 0.0) / adjusted_n)
    return Estimate((gained - lost) / n, max(-1.0, centre - half), min(1.0, centre + half), n)

"""Means, shares and paired differences with 95 % intervals, clustered by scene.

Runs on one scene resemble one another, so n runs on k scenes say less than n scenes. All intervals
follow from the k sums over scenes: Student's t with a cluster-robust variance for means, Korn and
Graubard's (1998) for shares, which is that of Clopper and Pearson with the effective number of
runs. With one run per scene they are the usual ones. Over a single scene, the runs take the place
of scenes: the interval then says nothing about other scenes.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

LEVEL = 0.95


class Estimate(NamedTuple):
    """Mean or share with its interval; NaN where there are too few values."""

    mean: float
    low: float
    high: float
    n: int
    """Number of runs."""
    scenes: int
    """Number of scenes; 1 makes the interval one over runs."""


UNKNOWN = Estimate(math.nan, math.nan, math.nan, 0, 0)


def rate(hits: Sequence[bool], scenes: Sequence[str]) -> Estimate:
    """Estimate a rate.

    Args:
        hits: outcome of each run.
        scenes: its scene.
    """
    return _estimate([float(hit) for hit in hits], scenes, share=True)


def mean(values: Sequence[float], scenes: Sequence[str]) -> Estimate:
    """Estimate a mean; its interval is NaN for fewer than two values.

    Args:
        values: value of each run.
        scenes: its scene.
    """
    return _estimate(values, scenes, share=False)


def _estimate(values: Sequence[float], scenes: Sequence[str], *, share: bool) -> Estimate:
    if not len(values):
        return UNKNOWN
    count = len(set(scenes))
    names = scenes if count > 1 else [str(k) for k in range(len(values))]
    parts = [(name, float(value), 1.0) for name, value in zip(names, values, strict=True)]
    found = ratio_interval(parts, share=share)
    center, low, high = (math.nan if x is None else x for x in found)
    return Estimate(center, low, high, len(values), count)


def rate_difference(
    hits: Sequence[bool], others: Sequence[bool], scenes: Sequence[str]
) -> Estimate:
    """Estimate the difference of two paired rates with Agresti and Min's adjusted Wald interval.

    Half an observation is added to each of the four outcomes of a scene, so that the interval has
    nonzero width even if all pairs agree. `mean` is the plain difference.

    Args:
        hits: first outcome of each pair.
        others: second outcome of each pair, which is subtracted.
        scenes: scene of each pair.
    """
    if not len(hits):
        return UNKNOWN
    differences = (np.asarray(hits, float) - np.asarray(others, float)).tolist()
    each, count = by_scene(differences, scenes), len(set(scenes))
    adjusted_n = len(each) + 2.0
    center = each.sum() / adjusted_n
    variance = max(((each**2).sum() + 1.0) / adjusted_n - center**2, 0.0) / adjusted_n
    half = float(stats.norm.ppf((1 + LEVEL) / 2)) * math.sqrt(variance)
    low, high = max(-1.0, center - half), min(1.0, center + half)
    return Estimate(float(np.mean(differences)), float(low), float(high), len(hits), count)


def by_scene(values: Sequence[float], scenes: Sequence[str]) -> Float[np.ndarray, " scene"]:
    """Return the mean of each scene's values; the values themselves for a single scene."""
    if len(set(scenes)) == 1:
        return np.asarray(values, float)
    groups: dict[str, list[float]] = {}
    for scene, value in zip(scenes, values, strict=True):
        groups.setdefault(scene, []).append(value)
    return np.array([np.mean(group) for group in groups.values()])


class PairedTest(NamedTuple):
    """Test of paired differences, over scenes."""

    wins: int
    """Scenes with a positive difference."""
    losses: int
    sign_p: float
    """Two-sided p of the sign test, ties dropped; 1 if all are ties."""
    effect: float
    """Mean difference over its standard deviation (Cohen's d for pairs); NaN if that is 0."""


def paired_test(differences: Sequence[float], scenes: Sequence[str]) -> PairedTest:
    """Test whether paired differences favour one side.

    Args:
        differences: difference of each pair.
        scenes: scene of each pair.
    """
    each = by_scene(differences, scenes)
    wins, losses = int((each > 0).sum()), int((each < 0).sum())
    p = float(stats.binomtest(wins, wins + losses).pvalue) if wins + losses else 1.0
    spread = float(np.std(each, ddof=1)) if len(each) > 1 else 0.0
    return PairedTest(wins, losses, p, float(each.mean()) / spread if spread else math.nan)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p values adjusted for their number by Holm's method."""
    count, largest = len(p_values), 0.0
    adjusted = [0.0] * count
    for rank, k in enumerate(sorted(range(count), key=lambda k: p_values[k])):
        largest = max(largest, min(1.0, (count - rank) * p_values[k]))
        adjusted[k] = largest
    return adjusted


Interval = tuple[float | None, float | None, float | None]
"""Mean, low and high; None if undefined."""


def ratio_interval(parts: Iterable[tuple[str, float, float]], *, share: bool = False) -> Interval:
    """Return sum over count of parts, with an interval clustered by group.

    Args:
        parts: group, such as a scene, sum and count of each part.
        share: True if the ratio is a share in [0, 1], whose interval has a width also where all
            parts agree.

    Returns:
        The ratio is None without a count, the ends of the interval for fewer than two groups.
    """
    totals: dict[str, np.ndarray] = {}
    number = 0
    for group, *part in parts:
        totals[group] = totals.get(group, np.zeros(2)) + part
        number += 1
    totals = {group: total for group, total in totals.items() if total[1] > 0}
    if not totals:
        return None, None, None
    sums, counts = np.array([totals[group] for group in sorted(totals)]).T
    ratio, groups = float(sums.sum() / counts.sum()), len(sums)
    if groups < 2:
        return ratio, None, None
    residual = float(((sums - ratio * counts) ** 2).sum() / counts.sum() ** 2)
    quantile = float(stats.t.ppf((1 + LEVEL) / 2, groups - 1))
    if not share:
        half = quantile * math.sqrt(residual * groups / (groups - 1))
        return ratio, ratio - half, ratio + half
    effective = float(groups)
    if residual > 0:
        narrow = float(stats.t.ppf((1 + LEVEL) / 2, max(number, groups) - 1)) / quantile
        effective = min(ratio * (1 - ratio) / residual * narrow**2, counts.sum())
    hits, tail = ratio * effective, (1 - LEVEL) / 2
    low = float(stats.beta.ppf(tail, hits, effective - hits + 1)) if ratio > 0 else 0.0
    high = float(stats.beta.ppf(1 - tail, hits + 1, effective - hits)) if ratio < 1 else 1.0
    return ratio, low, high

"""Means, shares and paired differences with 95 % intervals, clustered by scene.

Runs on the same scene are correlated, so n runs on k scenes carry less information than runs on n
scenes. All intervals are therefore computed from the k sums over scenes:

- means: Student's t interval with a cluster-robust variance;
- shares: the interval of Korn and Graubard (1998), which is the Clopper-Pearson interval with the
  effective number of runs.

With one run per scene, these are the usual intervals. If there is a single scene, intervals are
computed over its runs, and say nothing about other scenes.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

LEVEL = 0.95
"""Confidence level of all intervals."""


class Estimate(NamedTuple):
    """A mean or a share with its interval. Values that are undefined are NaN."""

    mean: float
    low: float
    high: float
    n: int
    """Number of runs."""
    scenes: int
    """Number of scenes. If it is 1, the interval is computed over runs."""


UNKNOWN = Estimate(math.nan, math.nan, math.nan, 0, 0)


def rate(hits: Sequence[bool], scenes: Sequence[str]) -> Estimate:
    """Estimate a rate, with its interval.

    Args:
        hits: outcome of each run.
        scenes: scene of each run.
    """
    return _estimate([float(hit) for hit in hits], scenes, share=True)


def mean(values: Sequence[float], scenes: Sequence[str]) -> Estimate:
    """Estimate a mean, with its interval. The interval is NaN if there are fewer than two values.

    Args:
        values: value of each run.
        scenes: scene of each run.
    """
    return _estimate(values, scenes, share=False)


def _estimate(values: Sequence[float], scenes: Sequence[str], *, share: bool) -> Estimate:
    if not len(values):
        return UNKNOWN
    count = len(set(scenes))
    names = scenes if count > 1 else [str(k) for k in range(len(values))]
    parts = [(name, float(value), 1.0) for name, value in zip(names, values, strict=True)]
    interval = ratio_interval(parts, share=share)
    center, low, high = (math.nan if x is None else x for x in interval)
    return Estimate(center, low, high, len(values), count)


def rate_difference(
    hits: Sequence[bool], others: Sequence[bool], scenes: Sequence[str]
) -> Estimate:
    """Estimate the difference between two paired rates.

    The interval is the adjusted Wald interval of Agresti and Min. Half an observation is added to
    each of the four possible outcomes of a pair, so that the width of the interval is not zero even
    if all pairs agree. The estimated mean is the unadjusted difference.

    Args:
        hits: first outcome of each pair.
        others: second outcome of each pair, whose rate is subtracted.
        scenes: scene of each pair.
    """
    if not len(hits):
        return UNKNOWN
    differences = (np.asarray(hits, float) - np.asarray(others, float)).tolist()
    scene_means, count = by_scene(differences, scenes), len(set(scenes))
    adjusted_n = len(scene_means) + 2.0
    center = scene_means.sum() / adjusted_n
    variance = max(((scene_means**2).sum() + 1.0) / adjusted_n - center**2, 0.0) / adjusted_n
    half = float(stats.norm.ppf((1 + LEVEL) / 2)) * math.sqrt(variance)
    low, high = max(-1.0, center - half), min(1.0, center + half)
    return Estimate(float(np.mean(differences)), float(low), float(high), len(hits), count)


def by_scene(values: Sequence[float], scenes: Sequence[str]) -> Float[np.ndarray, " scene"]:
    """Return the mean value of each scene. If there is only one scene, return all its values."""
    if len(set(scenes)) == 1:
        return np.asarray(values, float)
    groups: dict[str, list[float]] = {}
    for scene, value in zip(scenes, values, strict=True):
        groups.setdefault(scene, []).append(value)
    return np.array([np.mean(group) for group in groups.values()])


Interval = tuple[float | None, float | None, float | None]
"""Mean, lower end and upper end; each is None if it is undefined."""


def ratio_interval(parts: Iterable[tuple[str, float, float]], *, share: bool = False) -> Interval:
    """Return the ratio of the total sum to the total count, with an interval clustered by group.

    Args:
        parts: group (such as a scene), sum and count of each part.
        share: if True, the ratio is a share in [0, 1]. The width of its interval is then positive
            even if all parts agree.

    Returns:
        The ratio and the ends of its interval. The ratio is None if the total count is 0; the ends
        are None if there are fewer than two groups.
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

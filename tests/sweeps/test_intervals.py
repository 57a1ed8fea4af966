import math

import numpy as np
import pytest
from scipy import stats as known

from neoworld_mjx.sweeps.intervals import mean, rate, rate_difference


def names(n):
    return [f"scene {k}" for k in range(n)]


@pytest.mark.parametrize(("hits", "n"), [(0, 5), (3, 7), (3, 3), (20, 20), (99, 100)])
def test_rates_over_scenes_have_clopper_and_pearsons_interval(hits, n):
    result = rate([True] * hits + [False] * (n - hits), names(n))
    truth = known.binomtest(hits, n).proportion_ci(method="exact")
    assert result == pytest.approx((hits / n, truth.low, truth.high, n, n))


def test_means_over_scenes_have_students_t_interval():
    x = np.random.default_rng(0).normal(size=9)
    low, high = known.t.interval(0.95, 8, loc=x.mean(), scale=known.sem(x))
    assert mean(list(x), names(9)) == pytest.approx((x.mean(), low, high, 9, 9))
    assert mean(list(x), ["one"] * 9) == pytest.approx((x.mean(), low, high, 9, 1))
    assert math.isnan(mean([1.0], ["one"]).low)
    assert math.isnan(mean([], []).mean)


def coverage(estimate, truth, draw, rounds=400):
    rng = np.random.default_rng(3)
    found = [estimate(*draw(rng)) for _ in range(rounds)]
    return np.mean([result.low <= truth <= result.high for result in found])


def test_clustered_intervals_cover_the_truth():
    scenes = list(np.repeat(names(10), 6))

    def values(rng):
        return list(np.repeat(rng.normal(1.0, 1.0, 10), 6) + rng.normal(0, 0.3, 60)), scenes

    def hits(rng):
        return (rng.random(60) < np.repeat(rng.beta(3, 2, 10), 6)).tolist(), scenes

    assert 0.92 <= coverage(mean, 1.0, values) <= 0.98
    assert 0.92 <= coverage(rate, 0.6, hits) <= 0.995


def test_paired_rates_cover_the_truth():
    truth = 0.1

    def pairs(rng):
        first = rng.random(60) < 0.7
        # A pair's second outcome is the first one's, but for a tenth that get worse.
        second = first & (rng.random(60) > truth / 0.7)
        return second.tolist(), first.tolist(), names(60)

    assert 0.92 <= coverage(rate_difference, -truth, pairs, 500) <= 0.99
    agreed = rate_difference([True] * 10, [True] * 10, names(10))
    assert agreed.mean == 0 and agreed.low < 0 < agreed.high
    # Ten runs of one scene each are not a hundred scenes.
    wide = rate_difference([True] * 100, [True] * 100, list(np.repeat(names(10), 10)))
    assert wide.high == pytest.approx(agreed.high)

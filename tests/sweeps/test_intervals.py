import math

import numpy as np
import pytest
from scipy import stats as known

from neoworld_mjx.sweeps.intervals import mean, rate, rate_difference


@pytest.mark.parametrize(("hits", "n"), [(0, 5), (3, 7), (20, 20), (99, 100)])
def test_rates_have_wilsons_interval(hits, n):
    result = rate([True] * hits + [False] * (n - hits))
    truth = known.binomtest(hits, n).proportion_ci(method="wilson")
    assert result == pytest.approx((hits / n, truth.low, truth.high, n))


def test_means_have_students_t_interval():
    x = np.random.default_rng(0).normal(size=9)
    low, high = known.t.interval(0.95, 8, loc=x.mean(), scale=known.sem(x))
    assert mean(list(x)) == pytest.approx((x.mean(), low, high, 9))
    assert math.isnan(mean([1.0]).low)
    assert math.isnan(mean([]).mean)


def test_paired_rates_cover_the_truth():
    rng = np.random.default_rng(1)
    inside, truth = 0, 0.1
    for _ in range(500):
        first = rng.random(60) < 0.7
        # A pair's second outcome is the first one's, but for a tenth that get worse.
        second = first & (rng.random(60) > truth / 0.7)
        result = rate_difference(second.tolist(), first.tolist())
        inside += result.low <= -truth <= result.high
    assert 0.92 <= inside / 500 <= 0.99
    agreed = rate_difference([True] * 10, [True] * 10)
    assert agreed.mean == 0 and agreed.low < 0 < agreed.high

"""The surrogate against its definition: ridge regression whose penalty and share come from leaving
each scored candidate out.
"""

import numpy as np
import pytest

from neoworld_mjx.refinement import surrogate
from neoworld_mjx.refinement.surrogate import MIN_SCORED, surrogate_scores

PENALTIES = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)


def by_definition(layouts, geometric, scored_layouts, scored_geometric, scores):
    """The estimates, with one regression for every candidate left out."""

    def features(z, g):
        z = np.clip(z, -3.0, 3.0)
        return np.hstack([z, z * z - 1.0, 5.0 * g[:, None]])

    def ridge(x, y, penalty):
        return np.linalg.solve(x.T @ x + penalty * np.eye(x.shape[1]), x.T @ y)

    known, targets = features(scored_layouts, scored_geometric), features(layouts, geometric)
    center = known.mean(axis=0)
    known, targets = known - center, targets - center
    difference = scores - scored_geometric
    mean = difference.sum() / (len(scores) + 1)
    rest = difference - mean
    base, errors = np.mean(rest**2), []
    for penalty in PENALTIES:
        left_out = []
        for k in range(len(rest)):
            others = np.arange(len(rest)) != k
            left_out.append(rest[k] - known[k] @ ridge(known[others], rest[others], penalty))
        errors.append(np.mean(np.square(left_out)))
    best = int(np.argmin(errors))
    predicted = np.zeros(len(targets))
    if len(rest) >= MIN_SCORED and errors[best] < base:
        predicted = (1 - errors[best] / base) * (targets @ ridge(known, rest, PENALTIES[best]))
    return np.clip(geometric + mean + predicted, 0.0, 1.0), predicted


@pytest.mark.parametrize("scored, size", [(9, 2), (20, 4), (40, 3), (12, 12)])
def test_estimates_are_those_of_the_definition(scored, size):
    """More and fewer numbers than candidates; some layouts lie beyond three deviations."""
    rng = np.random.default_rng(scored)
    z = 1.6 * rng.normal(size=(scored + 30, size))
    g = rng.uniform(0.3, 0.5, len(z))
    scores = g + 0.1 + 0.06 * z[:, 0] - 0.02 * z[:, 1] ** 2 + rng.normal(0, 0.005, len(z))
    given = z[scored:], g[scored:], z[:scored], g[:scored], scores[:scored]
    expected, predicted = by_definition(*given)
    assert np.ptp(predicted) > 0.05 and np.abs(z).max() > 3
    assert expected.min() > 0 and expected.max() < 1
    assert surrogate_scores(*given) == pytest.approx(expected, abs=1e-9)


def test_repeated_candidates_have_finite_estimates():
    """Repeated rows have eigenvalues of zero, up to rounding."""
    rng = np.random.default_rng(3)
    z, g = np.repeat(rng.normal(size=(4, 12)), 3, axis=0), np.repeat(rng.uniform(0.3, 0.5, 4), 3)
    given = z + 0.1, g, z, g, g + 0.1 * z[:, 0] + 0.3
    expected, predicted = by_definition(*given)
    assert np.ptp(predicted) > 0.01
    assert surrogate_scores(*given) == pytest.approx(expected, abs=1e-9)


def test_the_mean_difference_is_shrunk_by_one_candidate():
    z, g = np.zeros((2, 3)), np.array([0.2, 0.9])
    known = np.arange(9.0).reshape(3, 3), np.array([0.1, 0.2, 0.3])
    # Differences 0.3, 0.1 and 0.2: their sum over 3 + 1.
    found = surrogate_scores(z, g, *known, np.array([0.4, 0.3, 0.5]))
    assert found == pytest.approx([0.2 + 0.15, 1.0])
    assert surrogate_scores(z, g, *known, known[1] - 0.4) == pytest.approx([0.0, 0.6])
    assert surrogate_scores(z, np.array([-0.1, 1.2]), z[:0], g[:0], g[:0]).tolist() == [0.0, 1.0]


def test_a_regression_needs_six_scores():
    z, g, _ = world(60)
    for count, learned in ((MIN_SCORED - 1, False), (MIN_SCORED, True)):
        rows = np.argsort(z[:50, 0])[:: 50 // count][:count]
        scores = g[rows] + 0.05 * z[rows, 0]
        found = surrogate_scores(z[50:], g[50:], z[rows], g[rows], scores) - g[50:]
        assert (np.ptp(found) > 1e-3) == learned
    assert MIN_SCORED == 6 and surrogate.PENALTIES == PENALTIES


def test_equal_differences_are_the_mean_alone():
    z, g, _ = world(30)
    found = surrogate_scores(z[8:], g[8:] / 2, z[:8], g[:8] / 2, g[:8] / 2)
    assert found == pytest.approx(g[8:] / 2)


def world(n, seed=0):
    """Truth falls off with the distance from an optimum; geometry estimates it with bias."""
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(n, 12))
    true = np.clip(0.9 - 0.03 * np.sum((z - 0.3) ** 2, axis=1), 0, 1)
    return z, np.clip(0.7 * true + 0.3 + rng.normal(0, 0.08, n), 0, 1), true


def test_without_scores_the_estimate_is_the_geometric_score():
    z, g, _ = world(10)
    np.testing.assert_array_equal(surrogate_scores(z, g, z[:0], g[:0], g[:0]), g)


def test_few_scores_keep_the_geometric_ranking():
    z, g, true = world(50)
    found = surrogate_scores(z, g, z[:4], g[:4], true[:4])
    np.testing.assert_allclose(found - g, (found - g)[0])
    assert np.mean(np.abs(found - true)) < np.mean(np.abs(g - true))


@pytest.mark.parametrize("seed", range(3))
def test_many_scores_beat_geometry(seed):
    z, g, true = world(300, seed)
    found = surrogate_scores(z[100:], g[100:], z[:100], g[:100], np.round(16 * true[:100]) / 16)
    assert np.all((found >= 0) & (found <= 1))
    shifted = g[100:] + np.mean(true[:100] - g[:100])
    error = np.sqrt(np.mean((found - true[100:]) ** 2))
    assert error < 0.7 * np.sqrt(np.mean((shifted - true[100:]) ** 2))


def test_noise_is_not_learned():
    z, g, _ = world(200)
    noise = np.clip(g[:40] + np.random.default_rng(1).normal(0, 0.1, 40), 0, 1)
    found = surrogate_scores(z[40:], g[40:], z[:40], g[:40], noise)
    assert np.sqrt(np.mean((found - g[40:]) ** 2)) < 0.04

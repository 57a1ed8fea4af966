"""Ranking of all candidates of a search, and iterations of unequal populations in one array."""

import numpy as np
import pytest

from neoworld_mjx.physics.engine import RolloutStatus
from neoworld_mjx.physics.layout import Layout, Poses
from neoworld_mjx.refinement.objective import Scores
from neoworld_mjx.refinement.rounds import (
    NOT_SAMPLED,
    Round,
    best_first,
    rank_candidates,
    stack_padded,
)


def iteration(valid, merit, absolute):
    pop = len(valid)
    zero = np.zeros((pop, 1), np.float32)
    poses = Poses(*(np.zeros((pop, 1, *last), np.float32) for last in ((3,), (4,), (), ())))
    merit, absolute = np.float32(merit), np.float32(absolute)
    scores = Scores(
        {}, np.array(valid), np.zeros(pop, np.int32), absolute, absolute, merit, zero, zero,
        np.ones((pop, 1), bool), None,
    )  # fmt: skip
    return Round(Layout.zero(pop, 1), poses, scores)


def test_valid_candidates_are_ranked_by_merit_and_the_others_by_absolute_reward():
    first = iteration([False], [9.0], [0.5])
    second = iteration([True, False, True, False], [1.0, 8.0, 3.0, 7.0], [2.0, 0.9, -1.0, -np.inf])
    order = rank_candidates([first, second])
    found = [entry for entry, absolute in order if np.isfinite(absolute)]
    assert found == [(1, 2), (1, 0), (1, 1), (0, 0)]
    assert dict(order)[1, 2] == -1.0 and dict(order)[0, 0] == 0.5
    # Entries that fill up the first iteration come last, with failed candidates.
    assert len(order) == 8 and {entry for entry, _ in order[4:]} == {(1, 3), (0, 1), (0, 2), (0, 3)}
    assert rank_candidates([]) == []


def test_equal_candidates_keep_their_order():
    assert list(best_first(np.array([True] * 3), np.ones(3), np.arange(3.0))) == [0, 1, 2]
    assert list(best_first(np.array([False] * 3), np.arange(3.0), np.ones(3))) == [0, 1, 2]


@pytest.mark.parametrize("fill", [-np.inf, 7.0])
def test_shorter_iterations_are_filled_up(fill):
    rows = stack_padded([np.float32([[1, 2]]), np.float32([[3, 4], [5, 6], [7, 8]])], fill)
    assert rows.dtype == np.float32 and rows.shape == (2, 3, 2)
    np.testing.assert_array_equal(rows[1], [[3, 4], [5, 6], [7, 8]])
    np.testing.assert_array_equal(rows[0], [[1, 2], [fill, fill], [fill, fill]])


def test_an_entry_that_was_not_drawn_has_no_status_of_a_rollout():
    assert NOT_SAMPLED == -1 and NOT_SAMPLED not in {int(status) for status in RolloutStatus}

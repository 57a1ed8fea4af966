"""Scores of the benchmark of scoring."""

import pytest

from benchmarks.scoring import scoring
from neoworld_mjx.config import SemanticOptions


@pytest.mark.slow
def test_scores_are_assigned_to_their_candidates():
    row = scoring(
        "bounded",
        objects=3,
        iterations=3,
        top=6,
        delay_s=0.05,
        failing=0.25,
        physics_s=0.05,
        real=True,
        population=16,
        backoff_s=0.01,
        options=SemanticOptions(picture_px=64),
    )
    assert (row.submitted, row.scored, row.misplaced) == (18, 18, 0)
    assert row.failed_calls > 0
    assert row.calls == 18 + row.failed_calls
    assert row.physics_s > 0.1
    assert row.both_s >= 3 * 0.05
    assert row.ratio == pytest.approx(row.both_s / max(row.physics_s, row.scoring_s), abs=0.01)
    assert "consecutive scores failed" in row.dead_stopped

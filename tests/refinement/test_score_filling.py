"""S_sem of a population from recorded scores: what the surrogate is given, and the summary."""

import numpy as np
import pytest

from neoworld_mjx.config import CEMOptions, SemanticOptions
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.refinement import scorer as scorers
from neoworld_mjx.refinement.score_log import ScoreLog, ScoringJob, layout_digest
from neoworld_mjx.refinement.scorer import ScoreSource, SemanticScorer
from tests.support import scenes
from tests.support.scenes import compile_scene

SIGMA = CEMOptions(sigma_xy=0.1, sigma_yaw_deg=9.0, sigma_log_scale=0.2)
GEOMETRIC = np.array([0.5, 0.6, 0.7, 0.8])


@pytest.fixture(scope="module")
def model():
    return compile_scene(scenes.blocks(), samples=16)


@pytest.fixture(scope="module")
def layouts(model):
    return scenes.random_layout(model, 4, seed=0)


def replayed(model, layouts, path, *outcomes):
    """A scorer whose record holds (iteration, candidate, fields) of one population."""
    scores = []
    for iteration, k, fields in outcomes:
        single = Layout(*(np.asarray(x)[k : k + 1] for x in vars(layouts).values()))
        job = ScoringJob((iteration, k), 0, layout_digest(single), single)
        scores.append(job.score(**{"used": iteration, **fields}))
    ScoreLog(path).add(scores)
    options = SemanticOptions(scorer="mllm")
    return SemanticScorer(model, None, None, options, cem=SIGMA, recorded=path)


def test_layouts_are_in_standard_deviations_of_the_objects_that_move(
    model, layouts, tmp_path, monkeypatch
):
    given = []

    def surrogate(*arrays):
        given.append(arrays)
        return np.array([0.1, 0.2, 0.3, 0.4])

    monkeypatch.setattr(scorers, "surrogate_scores", surrogate)
    answers = (0, 2, {"value": 0.25}), (0, 1, {"error": "no"}), (1, 3, {"value": 0.75})
    with replayed(model, layouts, tmp_path / "scores.jsonl", *answers) as scorer:
        poses = model.place(layouts)
        scorer.submit(0, [2, 1], layouts, poses)
        assert [s.identity for s in scorer.collect(0)] == [(0, 1), (0, 2)]
        values, marks = scorer.s_sem_of(0, layouts, GEOMETRIC)
        assert values.dtype == np.float32
        assert values == pytest.approx([0.1, 0.2, 0.25, 0.4])
        expected = [
            ScoreSource.ESTIMATED,
            ScoreSource.ESTIMATED,
            ScoreSource.SCORED,
            ScoreSource.ESTIMATED,
        ]
        assert marks.tolist() == expected
        numbers, base, known, known_base, scores = given[0]
        moves = np.flatnonzero(model.optimised)
        assert 0 < len(moves) < len(model.names)
        columns = [
            np.asarray(layouts.xy)[:, k, axis] / (0.1 * np.asarray(model.diagonal)[k])
            for k in moves
            for axis in (0, 1)
        ]
        columns += [np.asarray(layouts.yaw)[:, k] / np.radians(9.0) for k in moves]
        columns += [np.asarray(layouts.log_scale)[:, k] / 0.2 for k in moves]
        assert numbers == pytest.approx(np.stack(columns, axis=1))
        assert np.array_equal(known, numbers[2:3])
        assert (base.tolist(), known_base.tolist(), scores.tolist()) == (
            GEOMETRIC.tolist(),
            [0.7],
            [0.25],
        )
        # Scores of earlier populations count with the geometric scores of their own.
        scorer.submit(1, [3], layouts, poses)
        scorer.collect(1)
        values, marks = scorer.s_sem_of(1, layouts, GEOMETRIC / 2)
        assert marks.tolist() == [*[ScoreSource.ESTIMATED] * 3, ScoreSource.SCORED]
        assert values == pytest.approx([0.1, 0.2, 0.3, 0.75])
        assert given[1][3].tolist() == [0.7, 0.4] and given[1][4].tolist() == [0.25, 0.75]
        assert len(given[1][2]) == 2


def test_a_deviation_of_zero_divides_by_almost_nothing(model, layouts, tmp_path, monkeypatch):
    given = []
    monkeypatch.setattr(
        scorers, "surrogate_scores", lambda *arrays: (given.append(arrays[0]), GEOMETRIC)[1]
    )
    path = tmp_path / "scores.jsonl"
    replayed(model, layouts, path, (0, 2, {"value": 0.25}))
    none = CEMOptions(sigma_yaw_deg=0.0)
    with SemanticScorer(model, None, None, cem=none, recorded=path) as scorer:
        scorer.submit(0, [2], layouts, model.place(layouts))
        scorer.collect(0)
        scorer.s_sem_of(0, layouts, GEOMETRIC)
    count = int(np.sum(model.optimised))
    yaw = np.asarray(layouts.yaw)[:, np.asarray(model.optimised)] / 1e-6
    assert given[0][:, 2 * count : 3 * count] == pytest.approx(yaw)


def test_the_summary_counts_each_kind_of_outcome(model, layouts, tmp_path):
    outcomes = (
        (0, 0, {"value": 0.5, "cost_usd": 0.1}),
        (0, 1, {"value": 0.5, "cached": True, "cost_usd": 0.0}),
        (0, 2, {"error": "no answer"}),
        (0, 3, {"error": "abandoned", "used": None}),
    )
    with replayed(model, layouts, tmp_path / "scores.jsonl", *outcomes) as scorer:
        scorer.submit(0, [0, 1, 2, 3], layouts, model.place(layouts))
        scorer.submit(0, [3, 0], layouts, model.place(layouts))  # Known already.
        scorer.collect(0)
        assert scorer.known((0, 2)) is None and scorer.known((0, 0)).value == 0.5
    waited = scorer.summary()["waited_s"]
    assert waited == round(scorer.waited_s, 3) and 0.0 <= scorer.waited_s < 1.0
    assert scorer.summary() == {
        "scorer": "recorded",
        "submitted": 4,
        "scored": 2,
        "equal_pictures": 1,
        "failed": 1,
        "unused": 1,
        "stopped": None,
        "cost_usd": None,
        "drawing_s": None,
        "waited_s": waited,
    }
    (note,) = scorer.fallbacks
    assert note.startswith("S_sem is estimated for 1 of 3 candidates") and "no answer" in note
    assert scorer.close() is None and scorer.summary()["unused"] == 1


def test_the_first_failure_is_reported(model, layouts, tmp_path):
    failures = (0, 0, {"error": "no answer"}), (0, 1, {"error": "another"})
    with replayed(model, layouts, tmp_path / "scores.jsonl", *failures) as scorer:
        scorer.submit(0, [0, 1], layouts, model.place(layouts))
        scorer.collect(0)
    (note,) = scorer.fallbacks
    assert note.endswith("failed; the first error: no answer")

"""scores.jsonl: what a line holds, and which recorded score belongs to which candidate."""

import json
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from pydantic import ValidationError

from neoworld_mjx.errors import ModelError
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.refinement.score_log import (
    SAME_LAYOUT,
    RecordedScores,
    ScoreLog,
    ScoringJob,
    layout_digest,
    layout_values,
    read_scores,
)

LAYOUT = Layout(
    np.float32([[[0.1, 0.2], [0.3, 0.4]]]), np.float32([[0.5, 0.6]]), np.float32([[0.7, 0.8]])
)


def moved(field="xy", by=0.01, index=0):
    """LAYOUT with one number changed."""
    parts = {name: np.array(getattr(LAYOUT, name)) for name in ("xy", "yaw", "log_scale")}
    parts[field].reshape(-1)[index] += by
    return Layout(**parts)


def job(iteration=0, candidate=0, rank=0, layout=LAYOUT):
    return ScoringJob((iteration, candidate), rank, layout_digest(layout), layout)


def recorded(tmp_path, *scores):
    path = tmp_path / "scores.jsonl"
    ScoreLog(path).add(scores)
    return path, RecordedScores(path)


def test_numbers_are_listed_by_object():
    assert layout_values(LAYOUT) == (0.1, 0.2, 0.5, 0.7, 0.3, 0.4, 0.6, 0.8)
    assert layout_values(moved(by=np.float32(1e-7))) == layout_values(LAYOUT)


def test_the_digest_differs_with_every_number():
    digests = {layout_digest(moved(*change)) for change in (("xy",), ("yaw",), ("log_scale",))}
    digests |= {layout_digest(moved(index=k)) for k in range(4)} | {layout_digest(LAYOUT)}
    assert len(digests) == 7
    assert all(len(digest) == 16 and int(digest, 16) >= 0 for digest in digests)
    as_double = Layout(*(np.float64(x) for x in (LAYOUT.xy, LAYOUT.yaw, LAYOUT.log_scale)))
    assert layout_digest(as_double) == layout_digest(LAYOUT)


def test_a_score_says_whose_it_is():
    score = job(3, 5, rank=2).score(value=0.25, used="final")
    assert score.identity == (score.iteration, score.candidate) == (3, 5)
    assert (score.rank, score.value, score.used, score.error) == (2, 0.25, "final", None)
    assert score.layout == layout_digest(LAYOUT) and score.numbers == layout_values(LAYOUT)
    assert not score.cached and score.cost_usd is None


def test_the_log_is_replaced_when_opened_and_then_appended_to(tmp_path):
    path = tmp_path / "refine" / "scores.jsonl"
    ScoreLog(path).add([job(9, 9).score()])
    log = ScoreLog(path)
    assert path.read_text() == "", "an earlier run's scores are gone"
    first, second = job(0, 1).score(value=0.5), job(1, 0).score(error="none")
    log.add([])
    log.add([first])
    log.add(score for score in [second, first])
    assert read_scores(path) == [first, second, first]
    assert path.read_text().count("\n") == 3
    ScoreLog(None).add([first])  # No file: nothing to do.


def test_a_log_that_cannot_be_written_or_read_is_one_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ModelError, match=r"cannot write .*file/scores.jsonl"):
        ScoreLog(tmp_path / "file" / "scores.jsonl")
    with pytest.raises(ModelError, match=r"none.jsonl"):
        read_scores(tmp_path / "none.jsonl")
    path, _ = recorded(tmp_path, job().score(value=1.0))
    path.write_text(path.read_text() + json.dumps({"iteration": 1, "candidate": "x"}) + "\n")
    with pytest.raises(ModelError, match=r"scores.jsonl, line 2: .*candidate"):
        read_scores(path)


@pytest.mark.parametrize("index", range(4))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_candidate_is_the_recorded_one_up_to_rounding(tmp_path, index, sign):
    _, known = recorded(tmp_path, job().score(value=0.5))
    known.put([job(layout=moved(by=sign * 0.9 * SAME_LAYOUT, index=index))])
    with pytest.raises(ModelError, match="the score of another layout for candidate 0 of iterat"):
        known.put([job(layout=moved(by=sign * 1.1 * SAME_LAYOUT, index=index))])


def test_a_record_without_numbers_is_compared_by_its_digest(tmp_path):
    score = job().score(value=0.5).model_copy(update={"numbers": None})
    path, known = recorded(tmp_path, score)
    known.put([job()])
    with pytest.raises(ModelError, match="another layout"):
        known.put([job(layout=moved(by=1e-5))])
    one_object = Layout(LAYOUT.xy[:, :1], LAYOUT.yaw[:, :1], LAYOUT.log_scale[:, :1])
    path.unlink()
    _, fewer = recorded(tmp_path, job(layout=one_object).score(value=0.5))
    with pytest.raises(ModelError, match="another layout"):
        fewer.put([job()])


def test_a_candidate_that_was_never_scored_is_named(tmp_path):
    path, known = recorded(tmp_path, job(1, 2).score(value=0.5))
    with pytest.raises(ModelError, match="has no score for candidate 1 of iteration 2") as error:
        known.put([job(1, 2), job(2, 1)])
    assert str(path) in str(error.value)


def test_scores_are_replayed_at_the_stage_of_their_first_use(tmp_path):
    jobs = [job(0, 3), job(0, 1), job(1, 0), job(1, 2)]
    used = [0, 1, 1, None]
    scores = [j.score(value=0.1, used=stage) for j, stage in zip(jobs, used, strict=True)]
    final = job(1, 1).score(value=0.2, used="final")
    _, known = recorded(tmp_path, *scores, final)
    assert known.take(0, [(0, 3)], others=True) == [], "nothing was submitted"
    known.put([*jobs[::-1], job(1, 1)])
    identities = lambda scores: [score.identity for score in scores]
    assert identities(known.take(0, [], others=True)) == [(0, 3)]
    assert identities(known.take(1, [], others=True)) == [(0, 1), (1, 0)]
    assert identities(known.take(1, [(1, 0), (0, 3)], others=False)) == [(1, 0)]
    assert identities(known.take("final", [(1, 1)], others=False)) == [(1, 1)]
    assert identities(known.close()) == [(1, 2)]
    assert known.stopped is None


def test_numbers_are_kept_to_a_millionth_and_a_job_does_not_change():
    assert layout_values(moved(by=np.float32(3e-6)))[0] == 0.100003
    with pytest.raises(FrozenInstanceError):
        job().rank = 1


def test_a_log_is_made_in_folders_that_do_not_exist_yet(tmp_path):
    path = tmp_path / "run" / "refine" / "scores.jsonl"
    ScoreLog(path).add([job().score()])
    assert read_scores(path) == [job().score()]


def test_a_score_does_not_change():
    with pytest.raises(ValidationError, match="frozen"):
        job().score().value = 0.5


def test_a_record_of_another_number_of_objects_is_another_layout(tmp_path):
    """At equal digests the numbers do not matter; at others they must be as many, and as large."""
    assert SAME_LAYOUT == 1e-3
    for numbers in (layout_values(LAYOUT)[:4], layout_values(LAYOUT) * 2, None):
        score = job().score(value=0.5).model_copy(update={"layout": "other", "numbers": numbers})
        _, known = recorded(tmp_path, score)
        with pytest.raises(ModelError, match="the score of another layout"):
            known.put([job()])

"""Inputs of `refine`: a scene or its path, an engine, and scores that arrive late."""

from inspect import unwrap
from types import SimpleNamespace

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import ConfigError, SpecError
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.refinement import scene_refinement as module
from neoworld_mjx.refinement.choosing import Round
from neoworld_mjx.refinement.objective import Scores
from neoworld_mjx.refinement.scene_refinement import read_composed, refine
from neoworld_mjx.refinement.scorer import ScoreSource
from tests.support import scenes
from tests.support.constant_scorer import ConstantScorer


def options(**given):
    return RefineOptions.model_validate(
        {
            "cem": {"population": 8, "iterations": 1},
            "rollout": {"duration_s": 0.1, "samples_per_object": 32},
            "check_duration_s": 0.1,
            **given,
        }
    )


@pytest.mark.parametrize(
    "name, population, opened",
    [
        ("auto", 256, "native"),
        ("auto", 257, "auto"),
        ("native", 4096, "native"),
        ("mjx", 8, "mjx"),
    ],
)
def test_automatic_engines_leave_small_populations_to_the_cores(
    monkeypatch, name, population, opened
):
    monkeypatch.setattr(module, "open_engine", lambda engine: engine)
    assert unwrap(module._open_engine)(name, options(cem={"population": population})) == opened


def test_a_scene_is_read_from_a_run_folder_before_its_refinement(tmp_path):
    composed, refined = scenes.blocks(), scenes.furnished()
    (tmp_path / "compose").mkdir()
    for path, scene in (("scene.json", refined), ("compose/scene.json", composed)):
        (tmp_path / path).write_text(scene.to_json())
    assert read_composed(tmp_path) == composed
    assert read_composed(tmp_path / "scene.json") == refined
    (tmp_path / "compose/scene.json").unlink()
    assert read_composed(tmp_path) == refined
    with pytest.raises(SpecError, match="nowhere"):
        read_composed(tmp_path / "nowhere")


def test_scores_that_come_late_count_in_the_choice_of_the_winner():
    pop = 4
    s_sem, zero = np.float32([0.1, 0.2, 0.3, 0.4]), np.zeros((pop, 1), np.float32)
    base = np.float32([1.0, 2.0, 3.0, -np.inf])
    scores = Scores(
        {"s_sem": s_sem, "d_pen": s_sem}, np.zeros(pop, bool), np.zeros(pop, np.int32),
        base, base + 10, base + 20, zero, zero, np.ones((pop, 1), bool), None,
    )  # fmt: skip
    round_ = Round(Layout.zero(pop, 1), None, scores)  # The poses are not read.
    marks = np.full(pop, ScoreSource.GEOMETRIC, np.int8)
    late = {(2, 0): 0.6, (1, 1): 0.9, (2, 3): 0.5}
    scorer = SimpleNamespace(known=late.get)
    after = unwrap(module._with_late_scores)(scorer, 2, round_, marks, 4.0)
    change = np.float32([0.5, 0, 0, 0.1])
    np.testing.assert_allclose(after.scores.terms["s_sem"], s_sem + change, rtol=1e-6)
    np.testing.assert_array_equal(after.scores.terms["d_pen"], s_sem)
    for name in ("reward", "absolute", "merit"):
        expected = getattr(scores, name) + 4.0 * change
        np.testing.assert_allclose(getattr(after.scores, name), expected, rtol=1e-6)
    assert list(marks) == [
        ScoreSource.SCORED,
        ScoreSource.GEOMETRIC,
        ScoreSource.GEOMETRIC,
        ScoreSource.SCORED,
    ]
    assert after.layouts is round_.layouts


def test_a_model_scores_only_where_its_scores_weigh():
    o = options(semantic={"scorer": "mllm"})
    with pytest.raises(ConfigError, match="needs the photograph and a model"):
        refine(scenes.blocks(), o, engine="native")
    weightless = options(semantic={"scorer": "mllm"}, reward={"w_sem": 0.0})
    assert not refine(scenes.blocks(), weightless).scoring


def test_the_delivered_scene_has_the_score_that_a_model_gave_its_candidate(monkeypatch):
    monkeypatch.setattr(module, "SemanticScorer", ConstantScorer)
    o = options(semantic={"scorer": "mllm"}, settle={"enabled": False})
    refined = refine(scenes.blocks(), o, engine="native")
    assert refined.winner[0] >= 0 and refined.delivered["s_sem"] == 0.25
    assert np.all(refined.history["s_sem_from"] == ScoreSource.SCORED)

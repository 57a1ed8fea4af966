"""Inputs and results of `refine`: a scene or its path, an engine, history and failures."""

from inspect import unwrap

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import ConfigError, SpecError
from neoworld_mjx.search import scene_refinement as module
from neoworld_mjx.search.scene_refinement import read_composed, refine
from neoworld_mjx.search.scorer import ScoreSource
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
    [("auto", 256, "native"), ("auto", 257, "auto"), ("native", 4096, "native"), ("mjx", 8, "mjx")],
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


def test_a_model_scores_only_where_its_scores_weigh():
    o = options(semantic={"scorer": "mllm"})
    with pytest.raises(ConfigError, match="needs the photograph and a model"):
        refine(scenes.blocks(), o, engine="native")
    weightless = options(semantic={"scorer": "mllm"}, reward={"w_sem": 0.0})
    assert not refine(scenes.blocks(), weightless).scoring


def test_the_history_states_which_scores_are_those_of_a_model(monkeypatch):
    monkeypatch.setattr(module, "SemanticScorer", ConstantScorer)
    o = options(semantic={"scorer": "mllm"})
    refined = refine(scenes.blocks(), o, engine="native")
    sources = refined.history["s_sem_from"]
    assert sources.shape == (1, 8) and np.all(sources == ScoreSource.SCORED)
    assert refined.scoring == {"calls": 0}


@pytest.fixture(scope="module")
def unmoved():
    """A search of one iteration, of a scene that passes; every object moves."""
    o = options(settle={"enabled": False}, cem={"population": 8, "iterations": 1})
    return o, refine(scenes.blocks(), o, engine="native")


def test_the_history_has_all_candidates_and_terms(unmoved):
    o, refined = unmoved
    history = refined.history
    assert history["reward"].shape == history["d_pen"].shape == (1, 8)
    assert history["xy"].shape == (1, 8, 4, 2)
    weights = dict(zip(history["term_names"], history["term_weights"], strict=True))
    assert weights == {
        "s_sem": o.reward.w_sem, "prior": pytest.approx(-o.reward.w_prior),
        "d_pen": pytest.approx(-o.reward.w_pen), "d_drift": pytest.approx(-o.reward.w_drift),
    }  # fmt: skip
    assert history["object_names"].tolist() == ["table", "low", "high", "ball"]
    assert "s_sem_from" not in history
    moving = np.asarray(refined.layout.log_scale)[0, 1:]
    assert refined.mean_log_scale == pytest.approx(moving.mean())
    assert repr(refined).startswith(f"Refined({refined.scene.name}: ")

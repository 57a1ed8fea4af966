"""Sweeps and ablations whose S_sem is a model's: one ledger and one cap, recorded and followed."""

import json

import numpy as np
import pytest
from neoworld_bench.named_scenes import photo_case
from PIL import Image

from neoworld_mjx.errors import BudgetError, ConfigError, ModelError, SpecError
from neoworld_mjx.refinement.score_log import SAME_LAYOUT, ScoreLog, read_scores
from neoworld_mjx.sweeps import Case, ablate, sweep
from neoworld_mjx.sweeps.model_scores import file_name
from tests.support import scenes
from tests.support.messages import MessagesServer

pytestmark = pytest.mark.usefixtures("without_figures")
WITHOUT = {"without S_sem": {"refine.reward.w_sem": 0}}


def plan(url="", **more):
    search = {
        "cem": {"population": 8, "iterations": 2, "elite_ratio": 0.5, "hold_resting": False},
        # Otherwise the composed scene settles and passes, and nothing is scored.
        "settle": {"enabled": False},
        "rollout": {"engine": "native", "duration_s": 0.1, "samples_per_object": 32},
        "semantic": {"scorer": "mllm", "top": 3, "wait": "all", "picture_px": 64},
        "check_duration_s": 0.1,
        "finalists": 2,
    }
    mllm = {"base_url": url, **more.pop("mllm", {})}
    return {
        "base": {"provider": "anthropic", "mllm": mllm, "refine": search},
        "seeds": [0, 1],
        **more,
    }


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    photo = tmp_path_factory.mktemp("photo") / "photo.png"
    Image.fromarray(np.full((32, 48, 3), 90, np.uint8)).save(photo)
    return Case("blocks", scenes.blocks(), photo=photo)


@pytest.fixture(scope="module")
def recorded(case, tmp_path_factory):
    """An ablation without S_sem, scored live, with the calls that the server counted."""
    out = tmp_path_factory.mktemp("ablation") / "live"
    with MessagesServer(delay_s=0.0, failing=0.0) as server:
        swept = ablate(plan(server.url, variants=WITHOUT), out, cases=[case])
        return swept, out, server.calls


def test_runs_without_s_sem_make_no_calls_and_the_ledger_adds_up(recorded):
    swept, out, calls = recorded
    ledger = json.loads((out / "sweep.json").read_text())["mllm"]
    assert [row["point"] for row in swept.rows] == ["base", "base", *2 * ["without S_sem"]]
    files = sorted(path.name for path in (out / "scores").iterdir())
    assert files == sorted(file_name("blocks", "base", seed) for seed in (0, 1))
    asked = [score for name in files for score in read_scores(out / "scores" / name)]
    assert all(score.value is not None for score in asked)
    sent = sum(not score.cached for score in asked)
    assert 0 < ledger["calls"] == calls <= sent
    assert ledger["known_cost_usd"] > 0


def test_recorded_scores_give_the_same_table_without_calls(recorded, case, tmp_path):
    swept, out, _ = recorded
    again = ablate(
        plan(variants=WITHOUT, scores=str(out / "scores")), tmp_path / "again", cases=[case]
    )
    for first, second in zip(swept.rows, again.rows, strict=True):
        assert (first["reward"], first["s_sem"]) == (second["reward"], second["s_sem"])
    assert again.about["mllm"] == {}
    with pytest.raises(ModelError, match="scores"):
        ablate(
            plan(variants=WITHOUT, scores=str(out / "scores"), seeds=[7]),
            tmp_path / "other",
            cases=[case],
        )


def test_a_tape_replaces_the_server(recorded, case, tmp_path):
    swept, out, _ = recorded
    request = plan(variants=WITHOUT, tapes=[str(out / "answers.tape.json")])
    request["base"]["provider"] = "replay"
    again = ablate(request, tmp_path / "taped", cases=[case])
    assert [row["s_sem"] for row in again.rows] == [row["s_sem"] for row in swept.rows]


def test_one_cap_holds_for_the_whole_sweep_and_a_higher_one_resumes_it(recorded, case, tmp_path):
    _, out, _ = recorded
    whole = json.loads((out / "sweep.json").read_text())["mllm"]["known_cost_usd"]
    with MessagesServer(delay_s=0.0, failing=0.0) as server:
        request = plan(
            server.url,
            axes={"refine.reward.w_sem": [0.5, 1.0]},
            mllm={"max_cost_usd": 1.2 * whole, "max_tokens": 256},
        )
        with pytest.raises(BudgetError, match="--resume"):
            sweep(request, tmp_path / "capped", cases=[case])
        spent = json.loads((tmp_path / "capped" / "sweep.json").read_text())["mllm"]
        assert 0 < spent["known_cost_usd"] <= 1.2 * whole
        request["base"]["mllm"]["max_cost_usd"] = 10.0
        done = sweep(request, tmp_path / "capped", cases=[case], resume=True)
        ledger = done.about["mllm"]
        assert len(done.rows) == 4 and ledger["calls"] == server.calls
        assert ledger["known_cost_usd"] > spent["known_cost_usd"]
    assert any("every run is a separate refinement" in line for line in done.about["static"])


def test_a_scene_without_a_photograph_is_refused_before_anything_runs(tmp_path):
    with pytest.raises(ConfigError, match="scene blocks: scores by a model need a photograph"):
        ablate(plan("http://127.0.0.1:9", variants=WITHOUT), cases=[scenes.blocks()])
    with pytest.raises(ConfigError, match="not a folder of recorded scores"):
        ablate(plan(variants=WITHOUT, scores=str(tmp_path / "none")), cases=[scenes.blocks()])


def test_scores_recorded_on_another_processor_apply(recorded, case, tmp_path):
    """Numbers decide that differ by roundings; the digest of their bits may differ."""
    swept, out, _ = recorded

    def follow(shift, name):
        for path in (out / "scores").iterdir():
            moved = [
                score.model_copy(
                    update={"layout": "0" * 16, "numbers": tuple(x + shift for x in score.numbers)}
                )
                for score in read_scores(path)
            ]
            ScoreLog(tmp_path / name / path.name).add(moved)
        return ablate(plan(variants=WITHOUT, scores=str(tmp_path / name), seeds=[0]), cases=[case])

    assert follow(0.5 * SAME_LAYOUT, "near").rows[0]["reward"] == swept.rows[0]["reward"]
    with pytest.raises(ModelError, match="the score of another layout"):
        follow(2 * SAME_LAYOUT, "far")


def test_only_examples_with_a_composed_scene_are_photo_case():
    assert photo_case("coffee").photo.name == "coffee.png"
    with pytest.raises(SpecError, match=r"scene photo:cofee: .*coffee"):
        photo_case("cofee")

"""The bundled examples answered by a model, here a local server that knows the tape's responses."""

import json

import pytest
from neoworld_bench import suites
from neoworld_bench.photographs.example_runs import COMPARED

from neoworld_mjx.config import load_config
from neoworld_mjx.errors import ConfigError, PhotoError
from neoworld_mjx.mllm.provider import bundled_tapes
from neoworld_mjx.mllm.replay import Tape
from tests.support.model_server import ModelServer, http, stream_of

QUICK = {
    "compose": {"align": {"enabled": False}},
    "refine": {"cem": {"population": 24, "iterations": 2}},
    "render": {"width": 96},
}
NAMES = ("parse", "parse:judge", "program:microwave", "judge-geometry:microwave")
CRITIC = "judge-articulation:microwave"


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    # Not those of compilations, which JAX_COMPILATION_CACHE_DIR names.
    monkeypatch.setenv("NEOWORLD_CACHE", str(tmp_path / "cache"))


def knowing(server, connection, body):
    """Answer a request with the tape's response of the same fields, seen by another camera."""
    fields = set(body["output_config"]["format"]["schema"]["properties"])
    entries = Tape.load(bundled_tapes() / "microwave.tape.json").answers.values()
    chosen = [e.answer for e in entries if e.name in (*NAMES, CRITIC) and e.model == "by hand"]
    answer = next(dict(each) for each in chosen if set(each) <= fields)
    if "camera" in answer:
        answer["camera"] = answer["camera"] | {"fovy_deg": answer["camera"]["fovy_deg"] + 3}
    text = stream_of("anthropic", body["model"], json.dumps(answer), usage=(1000, 200))
    connection.sendall(http(200, text, kind="text/event-stream"))


def run_examples(out, **changes):
    config = load_config(None, QUICK | changes)
    options = suites.Examples(example=("microwave",), provider="anthropic", out=out)
    return suites.SUITES["examples"].load()(options, config)


@pytest.mark.slow
def test_a_model_answers_the_examples_and_differences_are_reported(tmp_path, monkeypatch):
    monkeypatch.setenv("ANTHROPIC_API_KEY", "sk-test-0123456789-do-not-show")
    with ModelServer("anthropic", knowing) as server:
        result = run_examples(tmp_path / "out", mllm={"base_url": server.url, "retries": 0})
        asked = len(server.bodies)
    bundled, recorded = result["rows"]
    assert (bundled["provider"], recorded["provider"]) == ("replay", "anthropic")
    assert bundled["answered_by"] == "by hand, from the photograph" and bundled["usd"] is None
    assert recorded["calls"] == bundled["calls"] == asked == 5
    assert recorded["answered_by"].startswith("claude-") and recorded["tokens_in"] == 1000 * asked
    assert recorded["usd"] > 0
    changed = result["differences"]["microwave"]
    assert "box_iou" in changed and set(changed) <= set(COMPARED)
    assert changed["box_iou"] == (bundled["box_iou"], recorded["box_iou"])
    tape = Tape.load(tmp_path / "out" / "microwave.tape.json")
    assert len(tape.answers) == asked and tape.date == recorded["date"] > "2026"
    assert tape.made == "recorded from provider anthropic"
    assert "sk-test" not in (tmp_path / "out" / "microwave.tape.json").read_text()


def test_another_provider_needs_a_folder_and_an_example_exists(tmp_path):
    with pytest.raises(ConfigError, match="--out DIR"):
        run_examples(None)
    options = suites.Examples(example=("microwaves",))
    with pytest.raises(PhotoError, match="did you mean 'microwave'"):
        suites.SUITES["examples"].load()(options, load_config())

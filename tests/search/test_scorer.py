"""Semantic scores by a model: the request, identity, waiting, failure and replay."""

import json
import socket
import threading
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
import pytest
from pydantic import ValidationError

from neoworld_mjx.config import MLLMOptions, SemanticOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.mllm import Panel, Picture, Tape
from neoworld_mjx.mllm.anthropic import Anthropic
from neoworld_mjx.mllm.replay import Replay
from neoworld_mjx.render import render_plain
from neoworld_mjx.search import scorer as module
from neoworld_mjx.search.scorer import (
    CRITERIA,
    PICTURE_PX,
    Judgement,
    ScoreSource,
    SemanticScorer,
    listing,
    score_request,
    system_text,
)
from tests.support import scenes
from tests.support.messages import MessagesServer, judged, levels_of
from tests.support.scenes import compile_scene

POP = 12
GEOMETRIC = np.linspace(0.4, 0.8, POP).astype(np.float32)
PHOTO = Picture("photo", np.random.default_rng(9).integers(0, 255, (60, 90, 3), dtype=np.uint8))


@pytest.fixture(scope="module")
def model():
    return compile_scene(scenes.blocks(), samples=32)


@pytest.fixture(scope="module")
def rounds(model):
    """Populations of three iterations with their poses."""
    layouts = [scenes.random_layout(model, POP, seed=t) for t in range(3)]
    return [(layout, model.place(layout)) for layout in layouts]


def options(**given):
    return SemanticOptions(**{"scorer": "mllm", "timeout_s": 60.0, "top": 5, **given})


@contextmanager
def panel_to(url, record=None, **given):
    requests = MLLMOptions(**{"base_url": url, **given})
    quick = patch("anthropic._base_client.INITIAL_RETRY_DELAY", 0.01)
    with quick, Panel(Anthropic(requests), requests, record=record) as panel:
        yield panel


@contextmanager
def opened(model, panel, **given):
    scorer = SemanticScorer(model, PHOTO, panel, options(**given))
    try:
        yield scorer
    finally:
        scorer.close()


def play(scorer, rounds):
    """Submit, collect and fill, as the search does; return S_sem and its sources."""
    seen = []
    for layouts, poses in rounds:
        scorer.submit(GEOMETRIC, GEOMETRIC, layouts, poses)
        seen.append(scorer.collect())
    return seen


def value_of(model, layouts, poses, k):
    """Return the server's score of a candidate, from the candidate's image."""
    scene = model.apply(layouts, k, poses)
    levels = levels_of(render_plain(scene, scene.camera, width=PICTURE_PX))
    return sum(levels.values()) / 16


def test_the_request_has_the_criteria_of_the_paper_and_the_photograph_first():
    text = " ".join(system_text().split())
    assert "Do not judge: - whether the objects cover the same pixels" in text
    assert all(f"- `{name}`:" in text for name in CRITERIA)
    scene = scenes.furnished()
    request = score_request(PHOTO, Picture("candidate", np.zeros((9, 9, 3), np.uint8)), scene)
    assert [p.label for p in request.pictures] == ["photo", "candidate"]
    assert request.role == "critic" and listing(scene) in request.prompt
    assert "- block: in cabinet (drawer)" in listing(scene)


def test_a_response_is_four_levels_with_reasons():
    good = {n: {"reason": "as it is", "level": k + 1} for k, n in enumerate(CRITERIA)}
    assert Judgement.model_validate(good).value == 10 / 16
    for level in (5, -1, 2.5, "3", True, None):
        with pytest.raises(ValidationError):
            Judgement.model_validate_json(
                json.dumps(good | {"intersections": {"reason": "", "level": level}})
            )
    with pytest.raises(ValidationError):
        Judgement.model_validate({name: good[name] for name in CRITERIA[1:]})


def test_every_score_is_assigned_to_its_candidate(model, rounds):
    with (
        MessagesServer(delay_s=0.01, failing=0.3) as server,
        panel_to(server.url) as panel,
        opened(model, panel) as scorer,
    ):
        seen = play(scorer, rounds)
    differences = []
    for t, (layouts, poses) in enumerate(rounds):
        values, sources = seen[t]
        scored = range(POP - 5, POP)
        assert [k for k in range(POP) if sources[k] == ScoreSource.SCORED] == [*scored]
        for k in scored:
            assert values[k] == pytest.approx(value_of(model, layouts, poses, k))
            differences.append(values[k] - GEOMETRIC[k])
        shift = sum(differences) / (len(differences) + 1)
        expected = np.clip(GEOMETRIC + shift, 0, 1)[: POP - 5]
        np.testing.assert_allclose(values[: POP - 5], expected, rtol=1e-5)
    summary = scorer.summary()
    assert (summary["submitted"], summary["scored"], summary["failed"]) == (15, 15, 0)
    assert summary["cost_usd"] == pytest.approx(panel.ledger.spent_usd, abs=1e-6) and not (
        scorer.fallbacks
    )


def test_a_late_score_does_not_count_and_is_reported(model, rounds):
    late = threading.Event()

    def answer(rgb):
        late.wait(30)
        return judged(rgb)

    with (
        MessagesServer(answer) as server,
        panel_to(server.url) as panel,
        opened(model, panel, timeout_s=0.0) as scorer,
    ):
        ((values, sources),) = play(scorer, rounds[:1])
        late.set()
        np.testing.assert_array_equal(values, GEOMETRIC)
        assert set(sources) == {ScoreSource.GEOMETRIC}
    assert scorer.summary()["failed"] == 5 and scorer.summary()["scored"] == 0
    assert scorer.fallbacks[0].endswith("5 of 5 requested scores: later than 0 s")


@pytest.mark.parametrize(
    ("given", "answer", "scored", "reason"),
    [
        ({"base_url": None}, judged, 0, "5 consecutive scores failed; the last"),
        ({"max_cost_usd": 0.1, "max_tokens": 4096}, judged, None, "cost cap reached"),
        ({}, lambda _: "I cannot tell.", 0, "5 consecutive scores failed"),
    ],
)
def test_failures_fall_back_to_geometry_and_are_reported(
    model, rounds, given, answer, scored, reason
):
    with socket.socket() as free, MessagesServer(answer) as server:
        free.bind(("127.0.0.1", 0))
        closed = f"http://127.0.0.1:{free.getsockname()[1]}"
        url = closed if "base_url" in given else server.url
        more = {key: value for key, value in given.items() if key != "base_url"}
        with panel_to(url, **more) as panel, opened(model, panel, top=POP) as scorer:
            seen = play(scorer, rounds)
    summary = scorer.summary()
    assert reason in scorer.stopped and reason in scorer.fallbacks[0]
    assert summary["scored"] + summary["failed"] == summary["submitted"] == 3 * POP
    assert scored is None or summary["scored"] == scored
    assert set(seen[-1][1]) == {ScoreSource.GEOMETRIC}
    if scored == 0:
        np.testing.assert_array_equal(seen[-1][0], GEOMETRIC)


def test_a_tape_replays_the_scores_without_a_server(model, rounds, tmp_path):
    tape = tmp_path / "answers.tape.json"
    with (
        MessagesServer(failing=0.2) as server,
        panel_to(server.url, record=tape) as panel,
        opened(model, panel) as scorer,
    ):
        seen = play(scorer, rounds)
    with Panel(Replay(Tape.load(tape), tape)) as panel, opened(model, panel) as repeated:
        for first, second in zip(play(repeated, rounds), seen, strict=True):
            np.testing.assert_array_equal(first, second)
    assert repeated.summary()["cost_usd"] == 0.0 and repeated.fallbacks == ()


def test_only_the_best_finite_candidates_are_requested_and_pending_ones_end(model, rounds):
    hang = threading.Event()
    with MessagesServer(lambda _: str(hang.wait(30))) as server:
        with panel_to(server.url) as panel, opened(model, panel, top=3) as scorer:
            reward = np.full(POP, -np.inf)
            reward[[0, 2, 4, 5]] = 0.1, 0.5, 0.5, np.nan
            scorer.submit(reward, GEOMETRIC, *rounds[0])
            assert list(scorer._pending) == [2, 4, 0]
        hang.set()
    assert all(future.done() for future in scorer._pending.values())


def test_what_cannot_be_scored_is_an_error(model, rounds, monkeypatch):
    panel = Panel(Replay(Tape(), "none"))
    with pytest.raises(ConfigError, match="needs the photograph"):
        SemanticScorer(model, None, panel, options())
    blind = compile_scene(scenes.blocks().model_copy(update={"camera": None}), samples=32)
    with pytest.raises(ConfigError, match="needs the parsed camera"):
        SemanticScorer(blind, PHOTO, panel, options())

    def broken(*_, **__):
        raise RuntimeError("broken")

    monkeypatch.setattr(module, "render_plain", broken)
    with opened(model, panel) as scorer, pytest.raises(RuntimeError, match="broken"):
        play(scorer, rounds)

"""Semantic scores by a model: identity, waiting, and failure."""

import json
import re
import socket
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import yaml

from neoworld_mjx.config import MLLMOptions, SemanticOptions, load_config
from neoworld_mjx.errors import ConfigError, ModelError
from neoworld_mjx.mllm import Panel, Picture, Tape
from neoworld_mjx.mllm.anthropic import Anthropic
from neoworld_mjx.mllm.replay import Replay
from neoworld_mjx.refinement.score_log import Score, read_scores
from neoworld_mjx.refinement.score_worker import scene_renderer
from neoworld_mjx.refinement.scorer import ScoreSource, SemanticScorer
from tests.support import scenes
from tests.support.messages import MessagesServer, judged, levels_of
from tests.support.scenes import compile_scene

POP = 24
GEOMETRIC = np.linspace(0.4, 0.8, POP)
PHOTO = Picture.of("photo", np.random.default_rng(9).integers(0, 255, (60, 90, 3), dtype=np.uint8))


@pytest.fixture(scope="module")
def model():
    return compile_scene(scenes.blocks(), samples=32)


@pytest.fixture(scope="module")
def rounds(model):
    """Populations of four iterations with their poses."""
    layouts = [scenes.random_layout(model, POP, seed=t) for t in range(4)]
    return [(result, model.place(result)) for result in layouts]


def options(**given):
    return SemanticOptions(**{"scorer": "mllm", "picture_px": 64, "timeout_s": 20.0, **given})


@contextmanager
def panel_to(url, record=None, **given):
    requests = MLLMOptions(**{"base_url": url, **given})
    quick = patch("anthropic._base_client.INITIAL_RETRY_DELAY", 0.01)
    with quick, Panel(Anthropic(requests), requests, record=record) as panel:
        yield panel


def play(scorer, rounds, gap_s=0.0, top=None):
    """Submit, wait, collect and fill, as the search does; return the results."""
    seen = []
    for t, (layouts, poses) in enumerate(rounds):
        scorer.submit(t, scorer.best(GEOMETRIC, top), layouts, poses)
        time.sleep(gap_s)
        scorer.collect(t)
        seen.append(scorer.s_sem_of(t, layouts, GEOMETRIC))
    return seen


def expected(model, layouts, poses, k):
    """Response of the server for a candidate, from the candidate's image."""
    return levels_of(scene_renderer(options())(model.apply(layouts, k, poses)))


def same(a, b):
    return all(
        np.array_equal(x, y)
        for first, second in zip(a, b, strict=True)
        for x, y in zip(first, second, strict=True)
    )


def test_every_score_is_assigned_to_its_candidate(model, rounds, tmp_path):
    log = tmp_path / "refine" / "scores.jsonl"
    with MessagesServer(delay_s=0.1, at_once=8, failing=0.3) as server:
        with (
            panel_to(server.url) as panel,
            SemanticScorer(model, PHOTO, panel, options(top=10), log=log) as scorer,
        ):
            seen = play(scorer, rounds)
        assert set(server.failures) == {"429", "500", "cut off", "invalid JSON"}
        assert 1 < server.most_served_at_once <= 8
        assert len(server.first_pictures) == 1
    best = list(range(POP - 1, POP - 11, -1))
    for t, (layouts, poses) in enumerate(rounds):
        values, marks = seen[t]
        for k in range(POP):
            score = scorer.known((t, k))
            if k not in best:
                assert score is None
                assert marks[k] == ScoreSource.ESTIMATED
                continue
            assert marks[k] == ScoreSource.SCORED
            assert score.levels == expected(model, layouts, poses, k)
            assert score.value == sum(score.levels.values()) / 16 == values[k]
    reported = scorer.summary()
    assert (reported["submitted"], reported["scored"], reported["failed"], reported["unused"]) == (
        40,
        40,
        0,
        0,
    )
    assert reported["cost_usd"] == pytest.approx(panel.ledger.spent_usd, abs=1e-6)
    assert reported["cost_usd"] > 0
    assert scorer.fallbacks == ()
    lines = read_scores(log)
    assert [s.identity for s in lines] == [(t, k) for t in range(4) for k in sorted(best)]
    assert all(s.used == s.iteration and s.asked <= s.answered for s in lines)


def test_results_do_not_depend_on_the_order_of_arrival(model, rounds):
    def run(seed):
        order = []

        def answer(rgb):
            text = judged(rgb)
            time.sleep(np.random.default_rng([seed, *text.encode()]).uniform(0, 0.1))
            order.append(text)
            return text

        with (
            MessagesServer(answer, delay_s=0.0, failing=0.1, seed=seed) as server,
            panel_to(server.url) as panel,
            SemanticScorer(model, PHOTO, panel, options()) as scorer,
        ):
            return play(scorer, rounds[:3]), order

    first, order = run(1)
    second, other = run(2)
    assert order != other
    assert same(first, second)


def test_identical_images_are_requested_once(model, rounds):
    layouts, poses = rounds[0]

    def draw(scene):
        return np.full((40, 60, 3), round(100 * scene.objects[1].xy[0]) % 2 * 90, np.uint8)

    with MessagesServer(delay_s=0.05, failing=0.0) as server:
        with (
            panel_to(server.url) as panel,
            SemanticScorer(model, PHOTO, panel, options(top=POP), draw=draw) as scorer,
        ):
            play(scorer, rounds[:2])
        assert server.calls == len(server.sent) == 2
    reported = scorer.summary()
    assert (reported["scored"], reported["equal_pictures"]) == (2 * POP, 2 * POP - 2)
    for k in range(POP):
        assert scorer.known((0, k)).levels == levels_of(draw(model.apply(layouts, k, poses)))


def test_bounded_waits_for_scores_of_the_permitted_age(model, rounds):
    late = threading.Event()
    first = [json.dumps(expected(model, *rounds[0], k)) for k in range(POP - 1, POP - 5, -1)]

    def answer(rgb):
        if json.dumps(levels_of(rgb)) not in first:
            late.wait(10)
        return judged(rgb)

    with (
        MessagesServer(answer, delay_s=0.05, failing=0.0) as server,
        panel_to(server.url) as panel,
        SemanticScorer(model, PHOTO, panel, options(top=4, wait="bounded", late=1)) as scorer,
    ):
        scorer.submit(0, scorer.best(GEOMETRIC), *rounds[0])
        assert scorer.collect(0) == []
        values, marks = scorer.s_sem_of(0, rounds[0][0], GEOMETRIC)
        assert set(marks) == {ScoreSource.GEOMETRIC}
        np.testing.assert_array_equal(values, GEOMETRIC.astype(np.float32))

        scorer.submit(1, scorer.best(GEOMETRIC), *rounds[1])
        assert [s.identity for s in scorer.collect(1)] == [(0, k) for k in range(POP - 4, POP)]
        values, marks = scorer.s_sem_of(1, rounds[1][0], GEOMETRIC)
        assert set(marks) == {ScoreSource.ESTIMATED}
        assert not np.array_equal(values, GEOMETRIC.astype(np.float32))
        assert list(scorer.s_sem_of(0, rounds[0][0], GEOMETRIC)[1]).count(ScoreSource.SCORED) == 4

        threading.Timer(0.2, late.set).start()
        came = scorer.await_for([(1, POP - 1), (1, 0), (0, POP - 1)])
        assert late.is_set()
        assert [s.identity for s in came] == [(1, POP - 1)]
        assert came[0].levels == expected(model, *rounds[1], POP - 1)
        assert came[0].used == "final"


def test_a_run_that_did_not_wait_is_replayed_from_its_log(model, rounds, tmp_path):
    log, again = tmp_path / "scores.jsonl", tmp_path / "again.jsonl"
    o = options(wait="none", top=6)

    def run(scorer, gap_s):
        seen = play(scorer, rounds, gap_s)
        scorer.await_for([(3, POP - 1), (2, POP - 1)])
        return [*seen, scorer.s_sem_of(3, rounds[3][0], GEOMETRIC)]

    with (
        MessagesServer(delay_s=0.15, failing=0.1) as server,
        panel_to(server.url) as panel,
        SemanticScorer(model, PHOTO, panel, o, log=log) as scorer,
    ):
        seen = run(scorer, 0.06)
    marks = [list(marks).count(ScoreSource.SCORED) for _, marks in seen]
    assert any(s.used not in (s.iteration, "final") for s in read_scores(log))
    assert sum(marks) < 5 * 6
    with SemanticScorer(model, None, None, o, log=again, recorded=log) as repeated:
        assert same(run(repeated, 0.0), seen)
    assert again.read_text() == log.read_text()
    assert repeated.summary()["scorer"] == "recorded"

    with SemanticScorer(model, None, None, o, recorded=log) as stranger:
        moved = type(rounds[0][0])(*(np.asarray(x) + 0.01 for x in vars(rounds[0][0]).values()))
        with pytest.raises(ModelError, match="another layout for candidate 23 of iteration 0"):
            stranger.submit(0, stranger.best(GEOMETRIC), moved, rounds[0][1])
        with pytest.raises(ModelError, match="has no score for candidate 3 of iteration 0"):
            stranger.submit(0, [3], *rounds[0])


def test_an_unreachable_server_falls_back_to_geometry_and_is_reported(model, rounds, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
    log = tmp_path / "scores.jsonl"
    with (
        panel_to(url) as panel,
        SemanticScorer(model, PHOTO, panel, options(give_up_after=5), log=log) as scorer,
    ):
        seen = play(scorer, rounds)
    for values, marks in seen:
        np.testing.assert_array_equal(values, GEOMETRIC.astype(np.float32))
        assert set(marks) == {ScoreSource.GEOMETRIC}
    assert "the connection failed" in scorer.stopped
    (note,) = scorer.fallbacks
    assert note.startswith("S_sem comes from geometry alone, because scores of 2")
    assert " of 32 candidates were not requested: " in note
    assert "5 consecutive scores failed" in note
    # Two calls per score; beyond the limit of five, only requests already in flight.
    assert panel.ledger.to_json()["calls"] <= 2 * 8
    lines = read_scores(log)
    assert len(lines) == 4 * 8
    assert all(s.value is None and s.error for s in lines)
    assert len({s.identity for s in lines}) == 32


def test_scores_are_estimated_after_the_server_fails(model, rounds):
    with MessagesServer(delay_s=0.02, failing=0.0) as server:
        with (
            panel_to(server.url) as panel,
            SemanticScorer(model, PHOTO, panel, options()) as scorer,
        ):
            play(scorer, rounds[:2])
            server.failing = 1.0
            scorer.submit(2, scorer.best(GEOMETRIC), *rounds[2])
            came = scorer.collect(2)
            _, marks = scorer.s_sem_of(2, rounds[2][0], GEOMETRIC)
    assert all(s.value is None for s in came)
    assert set(marks) == {ScoreSource.ESTIMATED}
    assert scorer.stopped
    assert scorer.fallbacks[0].startswith("S_sem comes from estimates, because ")


def test_a_failed_score_is_estimated(model, rounds):
    """Every third picture fails for good; the others keep the scorer alive."""

    def answer(rgb):
        return "I cannot tell." if levels_of(rgb)["relative_size"] == 2 else judged(rgb)

    with (
        MessagesServer(answer, delay_s=0.0, failing=0.0) as server,
        panel_to(server.url) as panel,
        SemanticScorer(model, PHOTO, panel, options(top=POP, give_up_after=50)) as scorer,
    ):
        (_, marks), *_ = play(scorer, rounds[:1])
    failed = [k for k in range(POP) if expected(model, *rounds[0], k)["relative_size"] == 2]
    assert failed
    assert [k for k in range(POP) if marks[k] == ScoreSource.ESTIMATED] == failed
    assert scorer.stopped is None
    assert scorer.fallbacks[0].startswith(f"S_sem is estimated for {len(failed)} of {POP}")
    assert "gave no valid response" in scorer.fallbacks[0]


def test_the_cost_limit_is_observed(model, rounds):
    with MessagesServer(delay_s=0.02, failing=0.1) as server:
        with (
            panel_to(server.url, max_cost_usd=0.26, max_tokens=16384) as panel,
            SemanticScorer(model, PHOTO, panel, options(top=12)) as scorer,
        ):
            seen = play(scorer, rounds)
    assert panel.ledger.spent_usd <= 0.26
    assert "cost cap reached" in scorer.stopped
    reported = scorer.summary()
    assert 12 <= reported["scored"] < reported["submitted"] == 48
    assert "cost cap reached" in scorer.fallbacks[0]
    assert set(seen[-1][1]) == {ScoreSource.ESTIMATED}


def test_scores_have_a_separate_cost_limit(model, rounds):
    with MessagesServer(delay_s=0.02, failing=0.0) as server:
        with (
            panel_to(server.url) as panel,
            SemanticScorer(model, PHOTO, panel, options(max_cost_usd=0.05)) as scorer,
        ):
            play(scorer, rounds)
    price = 700 * 2e-6 + 250 * 10e-6 + 2500 * 0.1e-6
    assert 0.05 <= scorer.summary()["cost_usd"] <= 0.05 + 8 * price
    assert "max_cost_usd of 0.05 USD is reached" in scorer.stopped
    with panel_to("http://127.0.0.1:9", critic={"model": "unheard-of"}) as panel:
        with pytest.raises(ConfigError, match="'unheard-of' has no price"):
            SemanticScorer(model, PHOTO, panel, options(max_cost_usd=1.0))


def test_a_request_times_out(model, rounds):
    hang = threading.Event()
    with MessagesServer(lambda _: str(hang.wait(10)), delay_s=0.0) as server:
        with (
            panel_to(server.url) as panel,
            SemanticScorer(model, PHOTO, panel, options(timeout_s=0.2)) as scorer,
        ):
            play(scorer, rounds[:2])
        hang.set()
    assert "no response in 0.2 s" in scorer.stopped


def test_pending_requests_are_abandoned_and_logged_at_the_end(model, rounds, tmp_path):
    log = tmp_path / "scores.jsonl"
    hang = threading.Event()
    with MessagesServer(lambda _: str(hang.wait(10)), delay_s=0.0) as server:
        with (
            panel_to(server.url) as panel,
            SemanticScorer(model, PHOTO, panel, options(wait="none", top=POP), log=log) as scorer,
        ):
            play(scorer, rounds[:1])
        hang.set()
    lines = read_scores(log)
    assert len(lines) == POP
    assert all(s.used is None and "search had ended" in s.error for s in lines)
    assert scorer.summary()["unused"] == POP
    assert scorer.fallbacks == ()


def test_a_tape_replays_the_scores_without_a_server(model, rounds, tmp_path):
    tape = tmp_path / "answers.tape.json"
    with (
        MessagesServer(delay_s=0.0, failing=0.2) as server,
        panel_to(server.url, record=tape) as panel,
        SemanticScorer(model, PHOTO, panel, options()) as scorer,
    ):
        seen = play(scorer, rounds[:2])
    with (
        Panel(Replay(Tape.load(tape), tape)) as panel,
        SemanticScorer(model, PHOTO, panel, options()) as repeated,
    ):
        assert same(play(repeated, rounds[:2]), seen)
        scorer = repeated
    assert scorer.summary()["cost_usd"] == 0.0
    assert scorer.fallbacks == ()


def test_candidates_of_non_finite_reward_are_not_requested(model):
    with SemanticScorer(model, PHOTO, Panel(Replay(Tape(), "none")), options(top=3)) as scorer:
        assert scorer.best(np.array([0.1, np.nan, 0.5, -np.inf, 0.5, np.inf])) == [2, 4, 0]
        assert scorer.best(np.array([0.1, 0.2]), top=1) == [1]


def test_a_missing_photo_or_camera_is_an_error_with_a_remedy(model):
    with pytest.raises(ConfigError, match="needs the photograph"):
        SemanticScorer(model, None, None, options())
    blind = compile_scene(scenes.blocks().model_copy(update={"camera": None}), samples=32)
    with pytest.raises(ConfigError, match="needs the parsed camera"):
        SemanticScorer(blind, PHOTO, Panel(Replay(Tape(), "none")), options())


def test_a_broken_renderer_raises_and_does_not_hang(model, rounds):
    def draw(scene):
        raise RuntimeError("broken")

    panel = Panel(Replay(Tape(), "none"))
    with SemanticScorer(model, PHOTO, panel, options(), draw=draw) as scorer:
        scorer.submit(0, [0, 1], *rounds[0])
        with pytest.raises(RuntimeError, match="broken"):
            scorer.collect(0)


def test_the_documentation_names_existing_options():
    page = Path(__file__).parents[2] / "docs/how-to/semantic-scores.md"
    text = page.read_text(encoding="utf-8")
    (block,) = re.findall(r"```yaml\n(.*?)```", text, re.S)
    config = load_config(None, yaml.safe_load(block))
    assert config.refine.semantic == SemanticOptions(scorer="mllm")
    table = text.split("## scores.jsonl")[1].split("##")[0]
    named = re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", table, re.M)))
    assert sorted(named) == sorted(Score.model_fields)

"""Both providers against a local server that fails, hangs, cuts off, and answers nonsense."""

import asyncio
import json
import re
import socket
import sys
import time
import traceback
from typing import Any

import pytest

from neoworld_mjx.config import MLLMOptions, RoleOptions, load_config
from neoworld_mjx.errors import BudgetError, ModelError, NeoWorldError
from neoworld_mjx.mllm import Panel, open_panel
from neoworld_mjx.mllm.ledger import token_bound
from neoworld_mjx.mllm.requests import Rejection
from tests.mllm.conftest import KEY
from tests.support.model_server import (
    GOOD,
    ModelServer,
    Script,
    cuts_off,
    ends_early,
    fails,
    hangs,
    http,
    resets,
    says,
    sends,
    stream_of,
)

SOME_MODEL = RoleOptions(model="some-model", max_tokens=512)
both = pytest.mark.parametrize("dialect", ["anthropic", "openai"])


def shown(error: BaseException) -> str:
    """Return everything that a traceback of this error would show."""
    return "".join(traceback.format_exception(error)) + repr(error)


def failure_of(panel: Panel, request) -> str:
    with pytest.raises(ModelError) as caught:
        panel.ask_sync(request)
    assert KEY not in shown(caught.value)
    assert KEY not in json.dumps(panel.ledger.to_json())
    return str(caught.value)


def fails_with_key(status: int, message: str = "no luck", headers: str = "") -> Script:
    """Fail like a careless server, which repeats the key."""
    return fails(status, f"{message}; key was {KEY}", headers)


@both
class TestBothProviders:
    def test_a_request_carries_text_picture_schema_and_key(self, connect, make, dialect):
        server, panel = connect(dialect, says())
        answer = panel.ask_sync(make.request())
        assert answer.value == make.Colour(name="red")
        assert (answer.usage.input, answer.usage.output) == (100, 20)
        text = json.dumps(server.bodies[0])
        for part in ("You see.", "Which colour?", "photo:", "json_schema", "base64"):
            assert part in text
        assert server.headers[0]["authorization"] == f"Bearer {KEY}"

    @pytest.mark.parametrize("status", [429, 529])
    def test_a_failed_call_is_retried_and_booked(self, connect, make, dialect, status):
        _, panel = connect(dialect, fails_with_key(status), says())
        assert panel.ask_sync(make.request()).value.name == "red"
        books = panel.ledger.to_json()
        assert (books["calls"], books["failed_calls"]) == (2, 1)

    def test_retry_after_is_obeyed_up_to_a_limit(self, connect, make, dialect):
        _, panel = connect(dialect, fails(429, headers="retry-after: 0.2\r\n"), says())
        start = time.perf_counter()
        panel.ask_sync(make.request())
        assert time.perf_counter() - start >= 0.2
        server, panel = connect(dialect, fails(429, headers="retry-after: 3600\r\n"))
        message = failure_of(panel, make.request())
        assert re.search(r"asks to wait 3600 s, longer than .* Resume the run later", message)
        assert len(server.bodies) == 1

    @pytest.mark.parametrize(
        ("script", "words"),
        [
            (fails_with_key(500), r"HTTP 500: no luck"),
            (resets, r"the connection failed"),
            (cuts_off, r"the connection failed|broke off"),
            (ends_early, r"broke off|garbled"),
            (hangs, r"no data from the server for 0\.1 s"),
        ],
    )
    def test_retries_are_bounded(self, connect, make, dialect, script, words):
        limit = 0.1 if script is hangs else 3.0
        server, panel = connect(dialect, script, retries=1, timeout_s=limit)
        message = failure_of(panel, make.request())
        assert re.search(f"parse: {dialect} did not answer in 2 tries.*{words}", message), message
        assert len(server.bodies) == 2

    def test_an_absent_server_is_a_failed_connection(self, connect, make, dialect):
        with socket.socket() as unused:
            unused.bind(("127.0.0.1", 0))
            url = f"http://127.0.0.1:{unused.getsockname()[1]}"
            _, panel = connect(dialect, says(), base_url=url, retries=0)
            assert re.search("in 1 try.*the connection failed", failure_of(panel, make.request()))

    @pytest.mark.parametrize(
        ("script", "words"),
        [
            (fails_with_key(401, "invalid"), r"the key in \w+_API_KEY was refused \(401: invalid"),
            (fails(404), r"does not know the model 'some-model'.*mllm\.reasoner\.model"),
            (fails(400, "too many pictures"), r"rejected the request.*too many pictures"),
            (fails(413), r"rejected the request"),
            (says("Sorry.", "refusal"), r"parse: some-model refused to answer"),
            (says(GOOD[:8], "length"), r"cut off at 512 tokens; raise mllm\.reasoner\.max_tokens"),
        ],
    )
    def test_hopeless_calls_fail_at_once(self, connect, make, dialect, script, words):
        server, panel = connect(dialect, script, reasoner=SOME_MODEL)
        message = failure_of(panel, make.request())
        assert re.search(words, message), message
        assert len(server.bodies) == 1

    @pytest.mark.parametrize("bad", ['{"name": 3}', ""])
    def test_an_invalid_answer_goes_back_with_its_error(self, connect, make, dialect, bad):
        server, panel = connect(dialect, says(bad), says(f"Here:\n```json\n{GOOD}\n```\n"))
        answer = panel.ask_sync(make.request())
        assert answer.value.name == "red"
        assert answer.usage.input == 200
        turns = [m["role"] for m in server.bodies[1]["messages"] if m["role"] != "system"]
        assert turns == ["user", "assistant", "user"]
        assert "That response cannot be used" in json.dumps(server.bodies[1]["messages"][-1])

    def test_invalid_answers_are_bounded(self, connect, make, dialect):
        server, panel = connect(dialect, says('{"name": 3}'), validation_rounds=2)
        message = failure_of(panel, make.request())
        assert "gave no valid response in 3 tries" in message
        assert "name: Input should be a valid string" in message
        assert len(server.bodies) == 3

    def test_an_unsupported_schema_is_put_in_words(self, connect, make, dialect):
        parameter = {"anthropic": "output_config", "openai": "response_format"}[dialect]
        server, panel = connect(dialect, fails(400, f"{parameter}: not supported"), says())
        # One after the other: a second that is under way already would still carry the schema.
        panel.ask_sync(make.request())
        panel.ask_sync(make.request(prompt="again"))
        (note,) = panel.ledger.to_json()["fallbacks"]
        assert "structured output is not supported" in note
        assert [parameter in body for body in server.bodies] == [True, False, False]
        assert "it must fit this JSON schema" in json.dumps(server.bodies[-1])

    def test_costs_add_up_to_the_served_tokens(self, connect, make, dialect, tmp_path):
        prices = tmp_path / "prices.yaml"
        prices.write_text("some-model: {input: 10, output: 100}\nother: {input: 1, output: 2}\n")
        _, panel = connect(
            dialect,
            says(usage=(100, 10)),
            fails(500),
            says('{"a": 1}', usage=(200, 20)),
            says(usage=(300, 30)),
            says(usage=(400, 40)),
            prices=prices,
            reasoner=SOME_MODEL,
            critic=RoleOptions(model="other"),
        )
        for request in (make.request(), make.request(prompt="2"), make.request(role="critic")):
            panel.ask_sync(request)
        books = panel.ledger.to_json()
        assert (books["tokens"]["input"], books["tokens"]["output"]) == (1000, 100)
        rows = {row["role"]: row["cost_usd"] for row in books["by_role_and_model"]}
        assert rows == pytest.approx({"reasoner": 12e-3, "critic": 0.48e-3})
        assert books["cost_usd"] == pytest.approx(panel.ledger.spent_usd)

    def test_the_cap_stops_before_the_call_and_the_run_resumes(
        self, connect, make, dialect, tmp_path
    ):
        prices = tmp_path / "prices.yaml"
        prices.write_text("m: {input: 0, output: 1000}\n")
        options: dict[str, Any] = {
            "prices": prices,
            "reasoner": RoleOptions(model="m", max_tokens=512),
            "record": tmp_path / "kept.tape.json",
        }
        requests = [make.request(prompt=str(i)) for i in range(6)]
        server, panel = connect(dialect, says(usage=(10, 400)), max_cost_usd=2.0, **options)
        with pytest.raises(BudgetError, match=r"raise mllm\.max_cost_usd and resume") as caught:
            panel.ask_many(requests)
        assert KEY not in shown(caught.value)
        # 0.4 USD a call, up to 0.512 reserved for one: four fit into 2 USD, a fifth may exceed it.
        assert len(server.bodies) == 4
        assert panel.ledger.spent_usd == pytest.approx(1.6)

        _, higher = connect(dialect, server=server, max_cost_usd=10.0, **options)
        higher.ledger.add_earlier(panel.ledger.to_json())
        assert len(higher.ask_many(requests)) == len(server.bodies) == 6
        assert higher.ledger.spent_usd == pytest.approx(2.4)

    def test_a_cap_needs_prices(self, connect, make, dialect):
        server, panel = connect(dialect, says(), max_cost_usd=1.0, reasoner=SOME_MODEL)
        assert "'some-model' has no price" in failure_of(panel, make.request())
        assert server.bodies == []

    def test_calls_are_limited_and_equal_requests_sent_once(self, connect, make, dialect):
        def slow(server, connection, body):
            time.sleep(0.03)
            says()(server, connection, body)

        server, panel = connect(dialect, slow, concurrency=3)
        requests = [make.request(prompt=str(i % 8), name=str(i)) for i in range(12)]
        panel.ask_many(requests)
        assert server.most_at_once == 3
        assert len(server.bodies) == 8

    def test_keys_stay_out_of_tapes_and_headers_come_from_the_environment(
        self, connect, make, dialect, tmp_path, monkeypatch
    ):
        monkeypatch.setenv("MY_TOKEN", "a-private-token")
        tape = tmp_path / "t.tape.json"
        answer = says(json.dumps({"name": f"{KEY} a-private-token"}))
        server, panel = connect(
            dialect, answer, record=tape, headers={"X-My-Token": "t ${MY_TOKEN}"}
        )
        panel.ask_sync(make.request())
        assert server.headers[0]["x-my-token"] == "t a-private-token"
        assert KEY not in tape.read_text()
        assert "a-private-token" not in tape.read_text()

    def test_no_logger_shows_the_key(self, connect, make, caplog, dialect):
        caplog.set_level("DEBUG")
        headers = {"x-my-key": "${ANTHROPIC_API_KEY}"}
        _, panel = connect(dialect, fails_with_key(500), says(), headers=headers)
        panel.ask_sync(make.request())
        assert caplog.records
        records = (str(record.__dict__) + record.getMessage() for record in caplog.records)
        assert KEY not in "".join(records)


def test_one_panel_serves_several_event_loops(connect, make):
    _, panel = connect("anthropic", says())
    for i in range(2):
        answer = asyncio.run(panel.ask(make.request(prompt=str(i))))
        assert answer.value.name == "red"

    async def ask_within_a_running_loop():
        return panel.ask_sync(make.request(prompt="within"))

    assert asyncio.run(ask_within_a_running_loop()).value.name == "red"
    panel.close()
    assert panel.ask_sync(make.request(prompt="anew")).value.name == "red"


def test_corrections_count_towards_the_reservation(make):
    request = make.request()
    corrected = token_bound(request, 256, [Rejection("x" * 5000, "wrong")])
    assert corrected.cache_write > token_bound(request, 256).cache_write + 5000 / 4


def test_system_text_and_photo_are_cached(connect, make):
    server, panel = connect("anthropic", says())
    panel.ask_sync(make.request())
    body = server.bodies[0]
    assert body["system"][0]["cache_control"] == {"type": "ephemeral"}
    images = [b for b in body["messages"][0]["content"] if b["type"] == "image"]
    assert images[0]["cache_control"] == {"type": "ephemeral"}
    assert server.headers[0]["x-api-key"] == KEY


def test_tokens_before_a_broken_stream_are_booked(connect, make):
    _, panel = connect("anthropic", ends_early, says())
    panel.ask_sync(make.request())
    assert panel.ledger.to_json()["tokens"]["input"] == 200


def test_missing_token_counts_count_at_their_bound(connect, make):
    events = stream_of("openai", "m", GOOD).split("\n\n")
    uncounted = "\n\n".join(event for event in events if '"usage"' not in event)
    script = sends(uncounted, kind="text/event-stream")
    _, panel = connect("openai", script, reasoner=RoleOptions(model="m", max_tokens=700))
    panel.ask_sync(make.request())
    books = panel.ledger.to_json()
    assert books["tokens"]["output"] == 700
    assert "the ledger has their upper bound" in next(iter(books["fallbacks"]))


@pytest.mark.parametrize("parameter", ["max_tokens", "stream_options"])
def test_openai_leaves_out_unsupported_parameters(connect, make, parameter):
    message = f"Unsupported parameter: '{parameter}' is not supported with this model."
    server, panel = connect("openai", fails(400, message), says())
    assert panel.ask_sync(make.request()).value.name == "red"
    assert [parameter in body for body in server.bodies] == [True, False]
    if parameter == "max_tokens":
        assert server.bodies[1]["max_completion_tokens"] == 16384


def test_rejected_token_limits_end_the_retries(connect, make):
    message = "max_tokens and max_completion_tokens are not supported"
    server, panel = connect("openai", fails(400, message))
    assert "rejected the request" in failure_of(panel, make.request())
    assert len(server.bodies) == 3


def test_openai_without_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "openai", None)
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    with pytest.raises(ModelError, match=r"uv sync --inexact --extra openai"):
        open_panel(MLLMOptions(), "openai")


def test_a_batch_costs_half_and_its_gaps_are_sent_singly(connect, make, tmp_path):
    prices = tmp_path / "prices.yaml"
    prices.write_text("m: {input: 1000, output: 0}\n")
    requests = [make.request(prompt=str(i)) for i in range(4)]

    def status(status: str) -> Script:
        def play(server, connection, body):
            if status == "created":
                assert [r["custom_id"] for r in body["requests"]] == [r.key for r in requests]
            batch = batch_of(server, "ended" if status == "ended" else "in_progress")
            connection.sendall(http(200, json.dumps(batch)))

        return play

    rows = [
        {"custom_id": requests[2].key, "result": success(GOOD)},
        {"custom_id": requests[0].key, "result": success(GOOD)},
        {"custom_id": requests[1].key, "result": success("prose")},
        {"custom_id": requests[3].key, "result": {"type": "expired"}},
    ]
    results = sends("\n".join(map(json.dumps, rows)), kind="application/x-jsonl")
    # The SDK looks a batch up once more to find its results.
    steps = [status(name) for name in ("created", "running", "ended", "ended")]
    server, panel = connect(
        "anthropic",
        *steps,
        results,
        says(usage=(50, 0)),
        prices=prices,
        reasoner=RoleOptions(model="m"),
    )
    panel.provider._batch_poll_s = 0.01
    answers = panel.batch(requests)
    assert [a.value.name for a in answers] == ["red"] * 4
    singles = [p for p in server.paths if not p.startswith("/v1/messages/batches")]
    assert len(singles) == 2
    # Three in the batch at 100 tokens and half price, two single ones at 50.
    assert panel.ledger.spent_usd == pytest.approx(3 * 100 * 1e-3 / 2 + 2 * 50 * 1e-3)


def batch_of(server: ModelServer, status: str) -> dict[str, Any]:
    counts = dict.fromkeys(("processing", "succeeded", "errored", "canceled", "expired"), 0)
    results = f"{server.url}/v1/messages/batches/b1/results" if status == "ended" else None
    return {
        "id": "b1",
        "type": "message_batch",
        "processing_status": status,
        "request_counts": counts,
        "created_at": "2026-01-01T00:00:00Z",
        "expires_at": "2026-01-02T00:00:00Z",
        "ended_at": None,
        "cancel_initiated_at": None,
        "archived_at": None,
        "results_url": results,
    }


def success(text: str) -> dict[str, Any]:
    message = {
        "id": "m",
        "type": "message",
        "role": "assistant",
        "model": "m",
        "content": [{"type": "text", "text": text}],
        "stop_reason": "end_turn",
        "stop_sequence": None,
        "usage": {"input_tokens": 100, "output_tokens": 5},
    }
    return {"type": "succeeded", "message": message}


@pytest.mark.parametrize(
    "options",
    [
        {"headers": {"Authorization": f"Bearer {KEY}"}},
        {"headers": {"x-api-key": KEY}},
        {"base_url": f"http://user:{KEY}@localhost"},
        {"base_url": f"http://localhost/?api_key={KEY}"},
    ],
)
def test_a_key_in_the_config_is_rejected_and_not_shown(options):
    with pytest.raises(NeoWorldError, match=r"run\.json") as caught:
        load_config(None, {"mllm": options})
    assert KEY not in shown(caught.value)
    with pytest.raises(ValueError, match=r"run\.json") as raw:
        MLLMOptions(**options)
    assert KEY not in str(raw.value)


def test_unset_variable_in_a_header_is_named(monkeypatch):
    monkeypatch.delenv("NOT_SET", raising=False)
    monkeypatch.setenv("ANTHROPIC_API_KEY", KEY)
    with pytest.raises(NeoWorldError, match="environment variable NOT_SET"):
        open_panel(MLLMOptions(headers={"x-key": "${NOT_SET}"}), "anthropic")

"""Both providers against a small server on loopback that misbehaves as told.

The server speaks raw sockets, so that it can reset, hang and cut off in the middle of a body.
"""

import contextlib
import json
import re
import socket
import socketserver
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from neoworld_mjx.config import MLLMOptions, RoleOptions
from neoworld_mjx.errors import BudgetError, ModelError, NeoWorldError
from neoworld_mjx.mllm import Panel, open_panel

KEY = "sk-test-0123456789-do-not-show"
PROVIDERS = ("anthropic", "openai")
GOOD = '{"name": "red"}'
Script = Callable[["Server", socket.socket, dict[str, Any]], None]


@dataclass
class Server:
    """Plays one script a call, the last one for ever, and keeps what it was asked."""

    dialect: str
    scripts: list[Script]
    bodies: list[dict[str, Any]] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)
    paths: list[str] = field(default_factory=list)
    at_once: int = 0
    most_at_once: int = 0
    served: list[tuple[int, int]] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)
    url: str = ""

    def handle(self, connection: socket.socket) -> None:
        file = connection.makefile("rb")
        path = file.readline().split(b" ")[1:2]
        if not path:
            return
        headers = {}
        for line in iter(file.readline, b"\r\n"):
            name, _, value = line.decode().partition(":")
            headers[name.lower()] = value.strip()
        length = int(headers.get("content-length", 0))
        body = json.loads(file.read(length)) if length else {}
        with self.lock:
            self.paths.append(path[0].decode())
            self.bodies.append(body)
            self.headers.append(headers)
            script = self.scripts.pop(0) if len(self.scripts) > 1 else self.scripts[0]
            self.at_once += 1
            self.most_at_once = max(self.most_at_once, self.at_once)
        try:
            script(self, connection, body)
        finally:
            with self.lock:
                self.at_once -= 1


def http(
    status: int, body: str, *, kind: str = "application/json", headers: str = "", cut: int = 0
):
    data = body.encode()
    head = (
        f"HTTP/1.1 {status} X\r\ncontent-type: {kind}\r\nconnection: close\r\n"
        f"content-length: {len(data)}\r\n{headers}\r\n"
    )
    return head.encode() + (data[:-cut] if cut else data)


def stream_of(server: Server, model: str, text: str, stop: str, usage: tuple[int, int]) -> str:
    """The body of a whole answer in the server's dialect."""
    parts = [text[i : i + 7] for i in range(0, len(text), 7)]
    if server.dialect == "anthropic":
        message = {
            "id": "m",
            "type": "message",
            "role": "assistant",
            "model": model,
            "content": [],
            "stop_reason": None,
            "stop_sequence": None,
            "usage": {
                "input_tokens": usage[0],
                "output_tokens": 1,
                "cache_read_input_tokens": 0,
                "cache_creation_input_tokens": 0,
            },
        }
        stop = {"end": "end_turn", "length": "max_tokens", "refusal": "refusal"}[stop]
        events: list[dict[str, Any]] = [{"type": "message_start", "message": message}]
        events.append({"type": "ping"})
        block = {"type": "text", "text": ""}
        events.append({"type": "content_block_start", "index": 0, "content_block": block})
        for part in parts:
            delta = {"type": "text_delta", "text": part}
            events.append({"type": "content_block_delta", "index": 0, "delta": delta})
        events.append({"type": "content_block_stop", "index": 0})
        ending = {"stop_reason": stop, "stop_sequence": None}
        count = {"output_tokens": usage[1]}
        events.append({"type": "message_delta", "delta": ending, "usage": count})
        events.append({"type": "message_stop"})
        return "".join(f"event: {e['type']}\ndata: {json.dumps(e)}\n\n" for e in events)
    stop = {"end": "stop", "length": "length", "refusal": "content_filter"}[stop]
    base = {"id": "c", "object": "chat.completion.chunk", "created": 1, "model": model}
    chunks: list[dict[str, Any]] = []
    for part in parts:
        choice = {"index": 0, "delta": {"role": "assistant", "content": part}}
        chunks.append(base | {"choices": [choice | {"finish_reason": None}]})
    chunks.append(base | {"choices": [{"index": 0, "delta": {}, "finish_reason": stop}]})
    count = {
        "prompt_tokens": usage[0],
        "completion_tokens": usage[1],
        "total_tokens": sum(usage),
    }
    chunks.append(base | {"choices": [], "usage": count})
    return "".join(f"data: {json.dumps(c)}\n\n" for c in chunks) + "data: [DONE]\n\n"


def says(text: str = GOOD, stop: str = "end", usage: tuple[int, int] = (100, 20)) -> Script:
    def play(server: Server, connection: socket.socket, body: dict[str, Any]) -> None:
        whole = stream_of(server, body["model"], text, stop, usage)
        with server.lock:
            server.served.append(usage)
        connection.sendall(http(200, whole, kind="text/event-stream"))

    return play


def fails(status: int, message: str = "no luck", headers: str = "") -> Script:
    def play(server: Server, connection: socket.socket, body: dict[str, Any]) -> None:
        echo = f"{message}; key was {KEY}"  # a careless server
        error = {"type": "error", "error": {"type": "some_error", "message": echo}}
        connection.sendall(http(status, json.dumps(error), headers=headers))

    return play


def resets(server: Server, connection: socket.socket, body: dict[str, Any]) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def hangs(server: Server, connection: socket.socket, body: dict[str, Any]) -> None:
    time.sleep(1.0)


def cuts_off(server: Server, connection: socket.socket, body: dict[str, Any]) -> None:
    whole = stream_of(server, body["model"], GOOD, "end", (100, 20))
    connection.sendall(http(200, whole, kind="text/event-stream", cut=len(whole) // 3))


def ends_early(server: Server, connection: socket.socket, body: dict[str, Any]) -> None:
    whole = stream_of(server, body["model"], GOOD, "end", (100, 20))
    connection.sendall(http(200, whole[: len(whole) // 2], kind="text/event-stream"))


@pytest.fixture
def serve() -> Iterator[Callable[..., Server]]:
    running: list[socketserver.ThreadingTCPServer] = []

    def start(dialect: str, *scripts: Script) -> Server:
        server = Server(dialect, list(scripts))

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                with contextlib.suppress(OSError):
                    server.handle(self.request)

        class Quiet(socketserver.ThreadingTCPServer):
            allow_reuse_address = True
            daemon_threads = True
            block_on_close = False
            request_queue_size = 64

        tcp = Quiet(("127.0.0.1", 0), Handler)
        threading.Thread(target=tcp.serve_forever, args=(0.02,), daemon=True).start()
        running.append(tcp)
        path = "/v1" if dialect == "openai" else ""
        server.url = f"http://127.0.0.1:{tcp.server_address[1]}{path}"
        return server

    yield start
    for tcp in running:
        tcp.shutdown()
        tcp.server_close()


@pytest.fixture
def open_to(monkeypatch, tmp_path) -> Iterator[Callable[..., Panel]]:
    monkeypatch.setenv("ANTHROPIC_API_KEY", KEY)
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    panels: list[Panel] = []

    def start(server: Server, record: Path | None = None, **options) -> Panel:
        if server.dialect == "openai":
            pytest.importorskip("openai")
        given = {"timeout_s": 3.0, "retries": 2, "base_url": server.url} | options
        panel = open_panel(MLLMOptions(**given), server.dialect, record=record)
        panel._calls.backoff_s = 0.01
        panels.append(panel)
        return panel

    yield start
    for panel in panels:
        panel.close()


def shown(error: BaseException) -> str:
    """Everything that a traceback of this error would show."""
    import traceback

    return "".join(traceback.format_exception(error)) + repr(error)


def failure_of(panel: Panel, request) -> str:
    start = time.perf_counter()
    with pytest.raises(ModelError) as caught:
        panel.ask_sync(request)
    assert time.perf_counter() - start < 5
    assert KEY not in shown(caught.value)
    assert KEY not in json.dumps(panel.ledger.to_json())
    return str(caught.value)


@pytest.mark.parametrize("dialect", PROVIDERS)
class TestServers:
    def test_good_answer(self, serve, open_to, make, dialect):
        server = serve(dialect, says())
        answer = open_to(server).ask_sync(make.request())
        assert answer.value == make.Colour(name="red")
        assert (answer.usage.input, answer.usage.output) == (100, 20)
        text = json.dumps(server.bodies[0])
        for part in ("You see.", "Which colour?", "photo:", "json_schema", "base64"):
            assert part in text
        assert server.headers[0]["authorization"] == f"Bearer {KEY}"

    @pytest.mark.parametrize("status", [429, 500, 503, 529])
    def test_failing_server_is_asked_again(self, serve, open_to, make, dialect, status):
        server = serve(dialect, fails(status), says())
        panel = open_to(server)
        assert panel.ask_sync(make.request()).value.name == "red"
        books = panel.ledger.to_json()
        assert (books["calls"], books["failed_calls"]) == (2, 1)

    def test_retry_after_is_heeded(self, serve, open_to, make, dialect):
        server = serve(dialect, fails(429, headers="retry-after: 0.4\r\n"), says())
        start = time.perf_counter()
        open_to(server).ask_sync(make.request())
        assert 0.4 <= time.perf_counter() - start < 5

    def test_too_long_a_wait_is_not_waited_for(self, serve, open_to, make, dialect):
        server = serve(dialect, fails(429, headers="retry-after: 3600\r\n"))
        said = failure_of(open_to(server), make.request())
        assert re.search(r"asks to wait 3600 s, longer than .* Resume the run later", said)
        assert len(server.bodies) == 1

    @pytest.mark.parametrize("script", [resets, cuts_off, ends_early, hangs])
    def test_broken_connection_is_tried_again(self, serve, open_to, make, dialect, script):
        server = serve(dialect, script, says())
        panel = open_to(server, timeout_s=0.3 if script is hangs else 3.0)
        assert panel.ask_sync(make.request()).value.name == "red"

    @pytest.mark.parametrize(
        ("script", "words"),
        [
            (fails(500), r"HTTP 500: no luck"),
            (fails(529, "overloaded"), r"HTTP 529: overloaded"),
            (resets, r"the connection failed"),
            (cuts_off, r"the connection failed|broke off"),
            (ends_early, r"broke off|garbled"),
            (hangs, r"no sign from the server for 0\.2 s"),
        ],
    )
    def test_tries_are_bounded(self, serve, open_to, make, dialect, script, words):
        server = serve(dialect, script)
        limit = 0.2 if script is hangs else 3.0
        said = failure_of(open_to(server, retries=1, timeout_s=limit), make.request())
        assert re.search(f"parse: {dialect} did not answer in 2 tries.*{words}", said), said
        assert len(server.bodies) == 2

    def test_no_server_at_all(self, serve, open_to, make, dialect):
        server = serve(dialect, says())
        with socket.socket() as unused:
            unused.bind(("127.0.0.1", 0))
            server.url = f"http://127.0.0.1:{unused.getsockname()[1]}"
            said = failure_of(open_to(server, retries=0), make.request())
        assert "in 1 try" in said
        assert "the connection failed" in said

    @pytest.mark.parametrize(
        ("script", "words"),
        [
            (fails(401, "invalid key"), r"the key in \w+_API_KEY was refused \(401: invalid key"),
            (fails(403), r"was refused \(403"),
            (fails(404), r"does not know the model 'some-model'.*mllm\.reasoner\.model"),
            (fails(400, "too many pictures"), r"rejected the request.*too many pictures"),
            (fails(413), r"rejected the request"),
            (says("Sorry.", "refusal"), r"parse: some-model refused to answer"),
            (says(GOOD[:8], "length"), r"cut off at 512 tokens; raise mllm\.reasoner\.max_tokens"),
        ],
    )
    def test_hopeless_is_one_clear_message_at_once(
        self, serve, open_to, make, dialect, script, words
    ):
        server = serve(dialect, script)
        role = RoleOptions(model="some-model", max_tokens=512)
        said = failure_of(open_to(server, reasoner=role), make.request())
        assert re.search(words, said), said
        assert len(server.bodies) == 1

    @pytest.mark.parametrize("bad", ["It is red.", '{"name": 3}', '{"colour": "red"}', ""])
    def test_invalid_answer_goes_back_with_its_error(self, serve, open_to, make, dialect, bad):
        server = serve(dialect, says(bad), says())
        answer = open_to(server).ask_sync(make.request())
        assert answer.value.name == "red"
        assert answer.usage.input == 200
        turns = [m["role"] for m in server.bodies[1]["messages"] if m["role"] != "system"]
        assert turns == ["user", "assistant", "user"]
        assert "That answer cannot be used" in json.dumps(server.bodies[1]["messages"][-1])

    def test_prose_around_json_is_fine(self, serve, open_to, make, dialect):
        server = serve(dialect, says(f"Here:\n```json\n{GOOD}\n```\n"))
        assert open_to(server).ask_sync(make.request()).value.name == "red"
        assert len(server.bodies) == 1

    def test_invalid_answers_are_bounded(self, serve, open_to, make, dialect):
        server = serve(dialect, says('{"name": 3}'))
        said = failure_of(open_to(server, validation_rounds=2), make.request())
        assert "gave no valid answer in 3 tries" in said
        assert "name: Input should be a valid string" in said
        assert len(server.bodies) == 3

    def test_schema_turned_down_is_asked_in_words_and_said(self, serve, open_to, make, dialect):
        names = {"anthropic": "output_config", "openai": "response_format"}
        server = serve(dialect, fails(400, f"{names[dialect]}: not supported"), says())
        panel = open_to(server)
        # One after the other: a second that is under way already would still carry the schema.
        panel.ask_sync(make.request())
        panel.ask_sync(make.request(prompt="again"))
        books = panel.ledger.to_json()
        (note,) = books["fallbacks"]
        assert "structured output is not supported" in note
        assert names[dialect] not in server.bodies[-1]
        assert "it must fit this JSON schema" in json.dumps(server.bodies[-1])

    def test_cost_adds_up_to_the_tokens_served(self, serve, open_to, make, dialect, tmp_path):
        prices = tmp_path / "prices.yaml"
        prices.write_text("some-model: {input: 10, output: 100}\nother: {input: 1, output: 2}\n")
        scripts = [says(usage=(100 + i, 10 * i)) for i in range(6)]
        server = serve(dialect, *scripts[:3], fails(500), says('{"a": 1}'), *scripts[3:])
        panel = open_to(
            server,
            prices=prices,
            concurrency=1,
            reasoner=RoleOptions(model="some-model"),
            critic=RoleOptions(model="other"),
        )
        for i in range(5):
            panel.ask_sync(make.request(prompt=str(i)))
        panel.ask_sync(make.request(role="critic"))
        books = panel.ledger.to_json()
        assert books["tokens"]["input"] == sum(i for i, _ in server.served)
        assert books["tokens"]["output"] == sum(o for _, o in server.served)
        rows = {row["role"]: row for row in books["by_role_and_model"]}
        last = server.served[-1]
        assert rows["critic"]["cost_usd"] == pytest.approx((last[0] + 2 * last[1]) / 1e6)
        rest = server.served[:-1]
        expected = sum(10 * i + 100 * o for i, o in rest) / 1e6
        assert rows["reasoner"]["cost_usd"] == pytest.approx(expected)
        assert books["cost_usd"] == pytest.approx(panel.ledger.spent_usd)

    def test_cap_stops_before_the_call_and_the_run_resumes(
        self, serve, open_to, make, dialect, tmp_path
    ):
        prices = tmp_path / "prices.yaml"
        prices.write_text("m: {input: 0, output: 1000}\n")
        server = serve(dialect, says(usage=(10, 400)))
        options: dict[str, Any] = {
            "prices": prices,
            "reasoner": RoleOptions(model="m", max_tokens=512),
        }
        tape = tmp_path / "kept.tape.json"
        asked = [make.request(prompt=str(i)) for i in range(10)]
        panel = open_to(server, record=tape, max_cost_usd=2.0, **options)
        with pytest.raises(BudgetError, match=r"raise mllm\.max_cost_usd and resume") as caught:
            panel.ask_many(asked)
        assert KEY not in shown(caught.value)
        # 0.4 USD a call, up to 0.512 held for one: four fit into 2 USD, a fifth could exceed it.
        assert len(server.bodies) == 4
        assert panel.ledger.spent_usd == pytest.approx(1.6)

        higher = open_to(server, record=tape, max_cost_usd=10.0, **options)
        higher.ledger.carry(panel.ledger.to_json())
        assert len(higher.ask_many(asked)) == 10
        assert len(server.bodies) == 10
        assert higher.ledger.spent_usd == pytest.approx(4.0)

    def test_cap_without_a_price_is_refused(self, serve, open_to, make, dialect):
        server = serve(dialect, says())
        role = RoleOptions(model="home-made")
        panel = open_to(server, max_cost_usd=1.0, reasoner=role)
        assert "'home-made' has no price" in failure_of(panel, make.request())
        assert server.bodies == []
        free = open_to(server, reasoner=role)
        free.ask_sync(make.request())
        books = free.ledger.to_json()
        assert books["cost_usd"] is None
        assert books["models_without_price"] == ["home-made"]

    def test_concurrency_is_limited(self, serve, open_to, make, dialect):
        def slow(server, connection, body):
            time.sleep(0.05)
            says()(server, connection, body)

        server = serve(dialect, slow)
        panel = open_to(server, concurrency=3, timeout_s=2.0)
        panel.ask_many([make.request(prompt=str(i)) for i in range(12)])
        assert server.most_at_once == 3

    def test_same_question_is_asked_once(self, serve, open_to, make, dialect):
        server = serve(dialect, says())
        open_to(server).ask_many([make.request(name=str(i)) for i in range(5)])
        assert len(server.bodies) == 1

    def test_keys_stay_out_of_tapes_and_headers_come_from_the_environment(
        self, serve, open_to, make, dialect, tmp_path, monkeypatch
    ):
        monkeypatch.setenv("MY_TOKEN", "a-private-token")
        server = serve(dialect, says(json.dumps({"name": f"{KEY} a-private-token"})))
        tape = tmp_path / "t.tape.json"
        panel = open_to(server, record=tape, headers={"X-My-Token": "t ${MY_TOKEN}"})
        panel.ask_sync(make.request())
        assert server.headers[0]["x-my-token"] == "t a-private-token"
        assert KEY not in tape.read_text()
        assert "a-private-token" not in tape.read_text()

    def test_one_panel_serves_several_event_loops(self, serve, open_to, make, dialect):
        import asyncio

        panel = open_to(serve(dialect, says()))
        for i in range(3):
            answer = asyncio.run(panel.ask(make.request(prompt=str(i))))
            assert answer.value.name == "red"
        panel.close()
        assert panel.ask_sync(make.request(prompt="anew")).value.name == "red"


@pytest.mark.parametrize("dialect", PROVIDERS)
def test_no_logger_shows_the_key(serve, open_to, make, caplog, dialect):
    caplog.set_level("DEBUG")
    server = serve(dialect, fails(500, "busy"), says())
    open_to(server, headers={"x-my-key": "${ANTHROPIC_API_KEY}"}).ask_sync(make.request())
    assert caplog.records
    assert KEY not in "".join(
        str(record.__dict__) + record.getMessage() for record in caplog.records
    )


def test_corrections_count_towards_what_is_held(make):
    from neoworld_mjx.mllm.ledger import most_tokens
    from neoworld_mjx.mllm.requests import Rejection

    asked = make.request()
    more = most_tokens(asked, 256, [Rejection("x" * 5000, "wrong")])
    assert more.cache_write > most_tokens(asked, 256).cache_write + 5000 / 4


def test_system_text_and_photo_are_cached(serve, open_to, make):
    server = serve("anthropic", says())
    open_to(server).ask_sync(make.request())
    body = server.bodies[0]
    assert body["system"][0]["cache_control"] == {"type": "ephemeral"}
    images = [b for b in body["messages"][0]["content"] if b["type"] == "image"]
    assert images[0]["cache_control"] == {"type": "ephemeral"}
    assert server.headers[0]["x-api-key"] == KEY


def test_tokens_before_a_broken_stream_are_booked(serve, open_to, make):
    server = serve("anthropic", ends_early, says())
    panel = open_to(server, reasoner=RoleOptions(model="claude-sonnet-5-5"))
    panel.ask_sync(make.request())
    assert panel.ledger.to_json()["tokens"]["input"] == 200


def test_server_without_token_counts_is_booked_upward(serve, open_to, make):
    def uncounted(server, connection, body):
        whole = stream_of(server, body["model"], GOOD, "end", (1, 1))
        lines = [line for line in whole.split("\n\n") if '"usage"' not in line]
        connection.sendall(http(200, "\n\n".join(lines), kind="text/event-stream"))

    panel = open_to(serve("openai", uncounted), reasoner=RoleOptions(model="m", max_tokens=700))
    panel.ask_sync(make.request())
    books = panel.ledger.to_json()
    assert books["tokens"]["output"] == 700
    assert "booked at their upper bound" in next(iter(books["fallbacks"]))


@pytest.mark.parametrize("given", ["max_tokens", "stream_options"])
def test_openai_parameters_that_are_turned_down_are_left_out(serve, open_to, make, given):
    message = f"Unsupported parameter: '{given}' is not supported with this model."
    server = serve("openai", fails(400, message), says())
    assert open_to(server).ask_sync(make.request()).value.name == "red"
    assert given in server.bodies[0]
    assert given not in server.bodies[1]
    if given == "max_tokens":
        assert server.bodies[1]["max_completion_tokens"] == 16384


def test_openai_without_its_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "openai", None)
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    with pytest.raises(ModelError, match=r"pip install 'neoworld-mjx\[openai\]'"):
        open_panel(MLLMOptions(), "openai")


def test_batch_takes_half_the_price_and_asks_the_rest_singly(serve, open_to, make, tmp_path):
    prices = tmp_path / "prices.yaml"
    prices.write_text("m: {input: 1000, output: 0}\n")
    asked = [make.request(prompt=str(i)) for i in range(4)]

    def create(server, connection, body):
        assert [r["custom_id"] for r in body["requests"]] == [r.key for r in asked]
        connection.sendall(http(200, json.dumps(batch_of(server, "in_progress"))))

    def running(server, connection, body):
        connection.sendall(http(200, json.dumps(batch_of(server, "in_progress"))))

    def ended(server, connection, body):
        connection.sendall(http(200, json.dumps(batch_of(server, "ended"))))

    def results(server, connection, body):
        rows = [
            {"custom_id": asked[2].key, "result": success(GOOD)},
            {"custom_id": asked[0].key, "result": success(GOOD)},
            {"custom_id": asked[1].key, "result": success("prose")},
            {"custom_id": asked[3].key, "result": {"type": "expired"}},
        ]
        text = "\n".join(map(json.dumps, rows))
        connection.sendall(http(200, text, kind="application/x-jsonl"))

    # The SDK looks a batch up once more to find its results.
    server = serve("anthropic", create, running, ended, ended, results, says(usage=(50, 0)))
    panel = open_to(server, prices=prices, reasoner=RoleOptions(model="m"))
    panel.provider._batch_poll_s = 0.01
    answers = panel.batch(asked)
    assert [a.value.name for a in answers] == ["red"] * 4
    singles = [p for p in server.paths if not p.startswith("/v1/messages/batches")]
    assert len(singles) == 2
    # Three in the batch at 100 tokens and half price, two single ones at 50.
    assert panel.ledger.spent_usd == pytest.approx(3 * 100 * 1e-3 / 2 + 2 * 50 * 1e-3)


def batch_of(server: Server, status: str) -> dict[str, Any]:
    counts = dict.fromkeys(("processing", "succeeded", "errored", "canceled", "expired"), 0)
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
        "results_url": f"{server.url}/v1/messages/batches/b1/results"
        if status == "ended"
        else None,
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
def test_a_key_in_the_config_is_refused_and_not_shown(options):
    from neoworld_mjx.config import load_config

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

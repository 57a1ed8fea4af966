"""Servers that send keys elsewhere, unpack to gigabytes, or never end."""

import gzip
import json
import re
import resource
import time
import zlib
from functools import cache

import pytest

from neoworld_mjx.config import MLLMOptions, RoleOptions
from neoworld_mjx.io.files import MIB
from neoworld_mjx.mllm.http_limits import MAX_ERROR_BYTES
from tests.mllm.test_servers import batch_of, both, failure_of
from tests.support.model_server import ModelServer, http, says, sends, stream_of

GROWTH_MB = 150
"""Growth of memory that a response may cause in these tests."""


def peak_mb() -> float:
    """Return the largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


def redirects(status: int, url: str):
    """Answer with a redirect."""
    return lambda server, connection, body: connection.sendall(
        http(status, "", headers=f"location: {url}\r\n")
    )


def repeats(piece: bytes, *, status: int = 200, seconds: float = 8.0, encoding: str = ""):
    """Answer with an endless body."""
    coding = f"content-encoding: {encoding}\r\n" if encoding else ""
    head = f"HTTP/1.1 {status} X\r\ncontent-type: text/event-stream\r\n{coding}\r\n".encode()

    def play(server, connection, body):
        connection.sendall(head)
        end = time.monotonic() + seconds
        while time.monotonic() < end and not server.closing.is_set():
            connection.sendall(piece)

    return play


@cache
def _bomb(piece: bytes) -> bytes:
    packer = zlib.compressobj(1, zlib.DEFLATED, 31)
    mebibyte = piece * (MIB // len(piece))
    return b"".join(packer.compress(mebibyte) for _ in range(512)) + packer.flush()


def packed(piece: bytes, status: int):
    """Answer with a gzip body that unpacks to 512 MiB."""
    bomb = _bomb(piece)
    head = (
        f"HTTP/1.1 {status} X\r\ncontent-type: text/event-stream\r\ncontent-encoding: gzip\r\n"
        f"content-length: {len(bomb)}\r\n\r\n"
    )
    return lambda server, connection, body: connection.sendall(head.encode() + bomb)


@both
class TestRedirects:
    @pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
    def test_nothing_is_sent_to_another_origin(self, connect, make, dialect, status, monkeypatch):
        monkeypatch.setenv("MY_KEY", "a-private-key")
        with ModelServer(dialect, says()) as other:
            server, panel = connect(
                dialect,
                redirects(status, f"{other.url}/v1/messages"),
                headers={"api-key": "${MY_KEY}"},
            )
            message = failure_of(panel, make.request())
        port = other.url.split(":")[2].partition("/")[0]
        assert re.search(rf"redirects to http://127\.0\.0\.1:{port}, .*mllm\.base_url", message)
        assert other.bodies == other.headers == []
        assert len(server.bodies) == 1

    def test_another_host_or_scheme_is_another_origin(self, connect, make, dialect):
        for start in ("http://localhost", "https://127.0.0.1"):
            server, panel = connect(dialect, redirects(307, start))
            assert "redirects to" in failure_of(panel, make.request())
            assert len(server.bodies) == 1

    def test_a_redirect_within_the_origin_is_followed(self, connect, make, dialect):
        server, panel = connect(dialect, redirects(307, "/elsewhere"), says())
        assert panel.ask_sync(make.request()).value.name == "red"
        assert server.paths[1] == "/elsewhere"

    def test_a_redirect_by_way_of_a_proxy_is_refused(self, connect, make, dialect, monkeypatch):
        with ModelServer(dialect, redirects(307, "http://elsewhere.invalid/"), says()) as proxy:
            monkeypatch.setenv("HTTP_PROXY", proxy.url.removesuffix("/v1"))
            monkeypatch.delenv("NO_PROXY", raising=False)
            _, panel = connect(dialect, says(), base_url="http://model.invalid/v1")
            message = failure_of(panel, make.request())
        assert "redirects to http://elsewhere.invalid" in message
        assert [path.startswith("http://model.invalid/") for path in proxy.paths] == [True]


def test_the_results_of_a_batch_are_fetched_from_the_same_origin(connect, make):
    with ModelServer("anthropic", sends("{}")) as other:

        def ended(server, connection, body):
            batch = batch_of(server, "ended") | {"results_url": f"{other.url}/results"}
            connection.sendall(http(200, json.dumps(batch)))

        _, panel = connect("anthropic", ended)
        panel.provider._batch_poll_s = 0.01
        with pytest.raises(Exception, match="redirects to http"):
            panel.batch([make.request()])
    assert other.headers == []


@both
class TestBodies:
    """Bodies are bounded before and after they are unpacked."""

    def test_an_error_that_unpacks_to_much(self, connect, make, dialect):
        _, panel = connect(dialect, packed(bytes(8), 400))
        before = peak_mb()
        assert "rejected the request" in failure_of(panel, make.request())
        assert peak_mb() - before < GROWTH_MB

    @pytest.mark.parametrize("status", [400, 500])
    def test_an_endless_error(self, connect, make, dialect, status):
        _, panel = connect(dialect, repeats(b"x" * 65536, status=status), retries=0)
        before = peak_mb()
        assert str(status) in failure_of(panel, make.request())
        assert peak_mb() - before < GROWTH_MB

    def test_the_start_of_a_long_error_is_reported(self, connect, make, dialect):
        text = json.dumps({"error": {"message": "too many pictures"}}).encode()
        _, panel = connect(dialect, repeats(text + b" " * MAX_ERROR_BYTES, status=400))
        assert "too many pictures" in failure_of(panel, make.request())

    def test_a_stream_that_unpacks_to_much(self, connect, make, dialect):
        _, panel = connect(dialect, packed(b": ping\n\n", 200))
        before = peak_mb()
        message = failure_of(panel, make.request())
        assert re.search(r"response has over \d+ MiB", message), message
        assert peak_mb() - before < GROWTH_MB

    def test_a_line_without_an_end(self, connect, make, dialect):
        _, panel = connect(dialect, repeats(b"x" * 65536))
        before = peak_mb()
        assert re.search(r"over \d+ MiB in one line", failure_of(panel, make.request()))
        assert peak_mb() - before < GROWTH_MB

    def test_data_behind_the_end_of_the_packed_body(self, connect, make, dialect):
        packed = gzip.compress(b": ping\n\n")
        _, panel = connect(dialect, repeats(packed + bytes(1 << 20), encoding="gzip"))
        before = peak_mb()
        assert re.search(r"response has over \d+ MiB", failure_of(panel, make.request()))
        assert peak_mb() - before < GROWTH_MB


@both
class TestDeadline:
    @pytest.mark.parametrize("what", ["pings", "deltas", "silence between"])
    def test_a_call_has_a_deadline(self, connect, make, dialect, what):
        text = stream_of(dialect, "m", "x" * 70)
        head, _, delta = text[: text.rfind("\n\n", 0, len(text) // 2)].rpartition("\n\n")
        piece = {"pings": ": ping", "deltas": delta, "silence between": " "}[what]

        def play(server, connection, body):
            intro = "HTTP/1.1 200 X\r\ncontent-type: text/event-stream\r\n\r\n"
            connection.sendall(f"{intro}{head}\n\n".encode())
            for _ in range(300):
                connection.sendall(f"{piece}\n\n".encode())
                if server.closing.wait(0.02):
                    break

        server, panel = connect(dialect, play, call_timeout_s=0.5, retries=4)
        message = failure_of(panel, make.request())
        assert re.search(r"took longer than 0\.5 s.*mllm\.call_timeout_s", message), message
        assert len(server.bodies) == 1

    def test_the_deadline_includes_the_retries(self, connect, make, dialect):
        def play(server, connection, body):
            server.closing.wait(0.2)
            connection.sendall(http(500, "{}"))

        server, panel = connect(dialect, play, call_timeout_s=0.5, retries=40)
        assert "took longer than 0.5 s" in failure_of(panel, make.request())
        assert len(server.bodies) < 5

    def test_a_call_beyond_its_deadline_is_booked(self, connect, make, dialect, tmp_path):
        prices = tmp_path / "prices.yaml"
        prices.write_text("m: {input: 0, output: 1000}\n")
        _, panel = connect(
            dialect,
            repeats(b": ping\n\n", seconds=2.0),
            call_timeout_s=0.3,
            prices=prices,
            reasoner=RoleOptions(model="m", max_tokens=512),
        )
        failure_of(panel, make.request())
        assert panel.ledger.spent_usd == pytest.approx(0.512)


def test_the_deadline_is_at_most_ten_minutes():
    assert MLLMOptions().call_timeout_s == 600
    with pytest.raises(ValueError, match="less than or equal to 600"):
        MLLMOptions(call_timeout_s=601)


@pytest.mark.parametrize(
    "body",
    ['{"choices": null}', '{"choices": [{"delta": null}]}', '{"choices": [null]}', "[]", "3"],
)
def test_a_stream_of_another_shape(connect, make, body):
    _, panel = connect("openai", sends(f"data: {body}\n\n", kind="text/event-stream"), retries=0)
    message = failure_of(panel, make.request())
    assert "does not respond as this provider's API does" in message, message
    assert "NoneType" not in message


@both
def test_an_answer_of_another_kind(connect, make, dialect):
    for value in ({"hello": 1}, [], "text"):
        _, panel = connect(dialect, sends(value), retries=0)
        message = failure_of(panel, make.request())
        assert "NoneType" not in message
        assert "TypeError" not in message

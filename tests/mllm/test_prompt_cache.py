"""Requests of all objects are sent at once, but the first one fills the server's prompt cache."""

import threading

from neoworld_mjx.mllm import Usage, server
from tests.mllm.conftest import ask_all
from tests.support.model_server import GOOD, answer_of, http


class CachingServer:
    """Answers; instructions can be read from its cache once it has begun to answer them."""

    def __init__(self) -> None:
        self.cached: set[str] = set()
        self.reads: list[bool] = []
        self.lock = threading.Lock()

    def __call__(self, model_server, connection, body):
        text = body["system"][0]["text"]
        with self.lock:
            read = text in self.cached
            self.reads.append(read)
        usage = (10, 2) if read else (1010, 2)
        body = answer_of("anthropic", "m", GOOD, usage=usage, cache_read=1000 if read else 0)
        with self.lock:
            self.cached.add(text)
        connection.sendall(http(200, body))


def test_one_request_writes_the_instructions_and_the_others_read_them(make, connect, monkeypatch):
    monkeypatch.setattr(server, "CACHE_S", 1000.0)
    script = CachingServer()
    _, panel = connect("anthropic", script)
    requests = [make.request(prompt=f"object {k}") for k in range(6)]
    ask_all(panel, requests)
    assert script.reads == [False] + 5 * [True]
    ask_all(panel, [make.request(prompt=f"object {k}", system="Other") for k in range(3)])
    assert script.reads[6:] == [False, True, True]
    usage = panel.ledger.to_json()["tokens"]
    assert usage == vars(Usage(input=2 * 1010 + 7 * 10, output=18, cache_read=7000))

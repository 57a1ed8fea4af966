"""Servers that fail, redirect, never end, or repeat the key: each case is one row of a table."""

import json
import re
import traceback
import zlib
from typing import Any, NamedTuple

import pytest

from neoworld_mjx.config import MLLMOptions, load_config
from neoworld_mjx.errors import ModelError, NeoWorldError
from tests.mllm.conftest import KEY
from tests.support.model_server import (
    GOOD,
    ModelServer,
    Script,
    cuts_off,
    fails,
    hangs,
    repeats,
    resets,
    says,
    sends,
)

SOME_MODEL: dict[str, Any] = {"reasoner": {"model": "some-model"}, "max_tokens": 512}
both = pytest.mark.parametrize("dialect", ["anthropic", "openai"])


def shown(error: BaseException) -> str:
    """Return everything that a traceback of this error would show."""
    return "".join(traceback.format_exception(error)) + repr(error)


def bomb(server: ModelServer, connection: Any, body: Any) -> None:
    """Answer with a gzip body that unpacks to 64 MiB."""
    packed = zlib.compress(bytes(64 << 20), wbits=31)
    head = f"HTTP/1.1 200 X\r\ncontent-encoding: gzip\r\ncontent-length: {len(packed)}\r\n\r\n"
    connection.sendall(head.encode() + packed)


class Hostile(NamedTuple):
    """A server, the message that it ends in, and the maximum number of calls that reach it."""

    script: Script
    message: str
    calls: int
    options: dict[str, Any] = {}


RETRIED = r"^parse: \w+ did not answer, with up to 4 retries: "
REFUSED = r"where neither the key nor the photograph is sent; .*mllm\.base_url$"
LATE = r"took longer than 0\.5 s including retries; .*mllm\.call_timeout_s$"
AT_ONCE = {"call_timeout_s": 0.5}
HOSTILE = {
    "500 with the key": Hostile(
        fails(500, f"no luck; key was {KEY}"), f"{RETRIED}HTTP 500: no luck", 5
    ),
    "429": Hostile(fails(429, "slow down"), f"{RETRIED}HTTP 429: slow down", 5),
    "a long wait": Hostile(
        fails(429, headers="retry-after: 3600\r\n"), f"{LATE}|{RETRIED}HTTP 429", 1, AT_ONCE
    ),
    "a reset": Hostile(resets, f"{RETRIED}the connection failed", 5),
    "a cut-off body": Hostile(cuts_off, f"{RETRIED}the connection failed", 5),
    "silence": Hostile(hangs, LATE, 1, AT_ONCE),
    "a slow drip": Hostile(repeats(b" ", 0.02), LATE, 1, AT_ONCE),
    "an endless body": Hostile(repeats(bytes(1 << 20)), r"response has over 16 MiB", 5),
    "a bomb": Hostile(bomb, "compresses its response", 5),
    "a redirect within": Hostile(sends("", 307, "location: /other\r\n"), REFUSED, 1),
    "a permanent redirect": Hostile(
        sends("", 301, "location: http://evil.invalid\r\n"), REFUSED, 1
    ),
    "a refused key": Hostile(
        fails(401, f"invalid {KEY}"), r"the key in \w+_API_KEY was refused \(401: invalid", 1
    ),
    "an unknown model": Hostile(
        fails(404), r"does not know the model 'some-model'.*mllm\.reasoner\.model", 1
    ),
    "a bad request": Hostile(fails(400, "too many pictures"), "rejected.*too many pictures", 2),
    "a large request": Hostile(fails(413), "rejected the request", 1),
    "a refusal": Hostile(says("Sorry.", "refusal"), "parse: some-model refused to answer", 1),
    "a cut-off answer": Hostile(
        says(GOOD[:8], "length"), r"cut off at 512 tokens; raise mllm\.max_tokens", 1
    ),
    "the wrong schema": Hostile(
        says('{"name": 3}'), "no valid response in 4 tries.*name: Input should be a valid string", 4
    ),
    "an endless line": Hostile(says("x" * 2_000_000), "2000000 characters, at most 1000000", 4),
    "no JSON": Hostile(sends("{"), "does not respond as this provider's API does", 1),
    "other JSON": Hostile(sends({"hello": 1}), "does not respond as this provider's API does", 1),
    "a list": Hostile(sends([]), "does not respond as this provider's API does", 1),
    "nulls": Hostile(
        sends({"content": None, "choices": None}), "does not respond as this provider's API", 1
    ),
}


@both
@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_server_ends_in_one_message_without_the_key(connect, make, dialect, name, caplog):
    caplog.set_level("DEBUG")
    hostile = HOSTILE[name]
    server, panel = connect(dialect, hostile.script, **SOME_MODEL, **hostile.options)
    with pytest.raises(ModelError) as caught:
        panel.ask_sync(make.request())
    message = str(caught.value)
    assert re.search(hostile.message, message), message
    assert 1 <= len(server.bodies) <= hostile.calls
    assert KEY not in shown(caught.value)
    assert KEY not in json.dumps(panel.ledger.to_json())
    records = (str(record.__dict__) + record.getMessage() for record in caplog.records)
    assert KEY not in "".join(records)


RECOVERING = {
    "429": fails(429),
    "529": fails(529),
    "a reset": resets,
    "a cut-off body": cuts_off,
    "the wrong schema": says('{"name": 3}'),
    "prose": says("It is red."),
    "an unsupported schema": fails(400, "structured output: not supported"),
}


@both
@pytest.mark.parametrize("name", RECOVERING)
def test_a_call_that_fails_once_is_repeated(connect, make, dialect, name):
    server, panel = connect(dialect, RECOVERING[name], says(f"Here:\n```json\n{GOOD}\n```\n"))
    assert panel.ask_sync(make.request()).value.name == "red"
    first, second = server.bodies
    if name == "an unsupported schema":
        assert len(first) == len(second) + 1
        assert "it must fit this JSON schema" in json.dumps(second)
        panel.ask_sync(make.request(prompt="again"))
        assert len(server.bodies) == 3  # The schema is not sent again.
    elif name in ("the wrong schema", "prose"):
        turns = [m["role"] for m in second["messages"] if m["role"] != "system"]
        assert turns == ["user", "assistant", "user"]
        assert "That response cannot be used" in json.dumps(second["messages"][-1])
    else:
        assert first == second


@both
def test_nothing_is_sent_to_a_server_that_a_redirect_names(connect, make, dialect, monkeypatch):
    monkeypatch.setenv("ANTHROPIC_CUSTOM_HEADERS", "x-mine: a-private-key")
    with ModelServer(dialect, says()) as other:
        redirect = sends("a-private-key", 307, f"location: {other.url}/v1/messages\r\n")
        _, panel = connect(dialect, redirect)
        with pytest.raises(ModelError, match=f"redirects to {other.url}") as caught:
            panel.ask_sync(make.request())
    assert other.bodies == other.headers == []
    assert "a-private-key" not in shown(caught.value) or dialect == "openai"


@both
def test_keys_stay_out_of_tapes(connect, make, dialect, tmp_path):
    tape = tmp_path / "t.tape.json"
    _, panel = connect(dialect, says(json.dumps({"name": f"my {KEY}"})), record=tape)
    panel.ask_sync(make.request())
    assert KEY not in tape.read_text() and "my [key]" in tape.read_text()


@pytest.mark.parametrize(
    "url", [f"http://user:{KEY}@localhost", f"http://localhost/?api_key={KEY}"]
)
def test_a_key_in_the_config_is_rejected_and_not_shown(url):
    with pytest.raises(NeoWorldError, match=r"run\.json") as caught:
        load_config(None, {"mllm": {"base_url": url}})
    assert KEY not in shown(caught.value)
    with pytest.raises(ValueError, match=r"run\.json") as raw:
        MLLMOptions(base_url=url)
    assert KEY not in str(raw.value)

"""The documented command for local servers: no key, one name of a model, one context of 32k."""

import json

import pytest

from neoworld_mjx.mllm import Tape, bundled_tapes
from tests.support.model_server import ModelServer, answer_of, http

pytest.importorskip("openai")
CONTEXT, RESPONSE = 32768, 8192
"""Context and longest response of the command in docs/models.md [token]."""
CHARS_PER_TOKEN, PIXELS_PER_TOKEN = 3.5, 28 * 28


@pytest.fixture
def local(monkeypatch):
    """A server that answers the requests of coffee by the titles of their schemas."""
    answers = Tape.load(bundled_tapes() / "coffee.tape.json").answers.values()
    by_name = {entry.name: entry.text for entry in answers}

    def script(server, connection, body):
        title = body["response_format"]["json_schema"]["name"]
        text = str(body["messages"])
        name = {"ParsedScene": "parse", "SceneCritique": "parse:judge"}.get(title)
        kind = "program" if title == "Program" else "judge-geometry"
        name = name or next(
            f"{kind}:{label}"
            for label in ("cup", "saucer", "spoon")
            if f"name: {label}\\n" in text or f"The real object: {label}" in text
        )
        connection.sendall(http(200, answer_of("openai", body["model"], by_name[name])))

    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    with ModelServer("openai", script) as server:
        monkeypatch.setenv("OPENAI_BASE_URL", server.url)
        yield server


def test_the_command_for_local_servers(local, neoworld, photo, tmp_path):
    words = ("--provider", "openai", "--model", "qwen3-vl:8b", "--fast", "--until", "program")
    bound = ("--set", f"mllm.max_tokens={RESPONSE}")
    done = neoworld("reconstruct", photo, "--out", tmp_path, *words, *bound, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["mllm"]["calls"] == 4 == len(local.bodies)
    assert {body["model"] for body in local.bodies} == {"qwen3-vl:8b"}
    assert {body["max_tokens"] for body in local.bodies} == {RESPONSE}
    for body in local.bodies:
        system, user = body["messages"]
        texts = [part["text"] for part in user["content"] if part["type"] == "text"]
        assert "it must fit this JSON schema" in texts[-1]
        assert '"title"' not in texts[-1]
        chars = len(system["content"]) + sum(map(len, texts)) + len(str(body["response_format"]))
        tokens = chars / CHARS_PER_TOKEN + 1568 * 1568 / PIXELS_PER_TOKEN
        assert tokens < CONTEXT - RESPONSE, "change the context in docs/models.md"

"""A panel's calls to servers of both APIs: content, accounting, limits, and event loops."""

import asyncio
import json
import threading
import time
from typing import Any

import pytest

from neoworld_mjx.config import RoleOptions
from neoworld_mjx.errors import BudgetError, ModelError
from tests.mllm.conftest import KEY, ask_all
from tests.support.model_server import GOOD, answer_of, fails, hangs, http, says

both = pytest.mark.parametrize("dialect", ["anthropic", "openai"])


@both
def test_a_request_carries_text_picture_schema_and_key(connect, make, dialect):
    server, panel = connect(dialect, says())
    answer = panel.ask_sync(make.request())
    assert answer.value == make.Colour(name="red")
    assert (answer.usage.input, answer.usage.output) == (100, 20)
    text = json.dumps(server.bodies[0])
    for part in ("You see.", "Which colour?", "photo:", "json_schema", "base64"):
        assert part in text
    assert server.headers[0]["authorization"] == f"Bearer {KEY}"


def test_system_text_and_photo_are_cached(connect, make, monkeypatch):
    monkeypatch.setenv("ANTHROPIC_CUSTOM_HEADERS", "X-My-Token: a token")
    server, panel = connect("anthropic", says())
    panel.ask_sync(make.request())
    (body,), (headers,) = server.bodies, server.headers
    assert body["system"][0]["cache_control"] == {"type": "ephemeral"}
    images = [b for b in body["messages"][0]["content"] if b["type"] == "image"]
    assert images[0]["cache_control"] == {"type": "ephemeral"}
    assert (headers["x-api-key"], headers["x-my-token"]) == (KEY, "a token")


@both
def test_costs_add_up_to_the_served_tokens(connect, make, dialect, tmp_path):
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
        reasoner=RoleOptions(model="some-model"),
        critic=RoleOptions(model="other"),
    )
    for request in (make.request(), make.request(prompt="2"), make.request(role="critic")):
        panel.ask_sync(request)
    books = panel.ledger.to_json()
    assert (books["tokens"]["input"], books["tokens"]["output"]) == (1000, 100)
    rows = {row["role"]: row["cost_usd"] for row in books["by_role_and_model"]}
    assert rows == pytest.approx({"reasoner": 12e-3, "critic": 0.48e-3})
    assert books["cost_usd"] == pytest.approx(panel.ledger.spent_usd)


@both
def test_the_cap_stops_before_the_call_and_the_run_resumes(connect, make, dialect, tmp_path):
    prices = tmp_path / "prices.yaml"
    prices.write_text("m: {input: 0, output: 1000}\n")
    options: dict[str, Any] = {
        "prices": prices,
        "reasoner": RoleOptions(model="m"),
        "max_tokens": 512,
        "record": tmp_path / "kept.tape.json",
    }
    requests = [make.request(prompt=str(i)) for i in range(6)]
    server, panel = connect(dialect, says(usage=(10, 400)), max_cost_usd=2.0, **options)
    with pytest.raises(BudgetError, match=r"raise mllm\.max_cost_usd and resume"):
        ask_all(panel, requests)
    # 0.4 USD a call, up to 0.512 reserved for one: four fit into 2 USD, a fifth may exceed it.
    assert len(server.bodies) == 4
    assert panel.ledger.spent_usd == pytest.approx(1.6)

    _, higher = connect(dialect, server=server, max_cost_usd=10.0, **options)
    higher.ledger.add_earlier(panel.ledger.to_json())
    assert len(ask_all(higher, requests)) == len(server.bodies) == 6
    assert higher.ledger.spent_usd == pytest.approx(2.4)


def test_a_cap_needs_prices(connect, make):
    model = RoleOptions(model="some-model")
    server, panel = connect("anthropic", says(), max_cost_usd=1.0, reasoner=model)
    with pytest.raises(BudgetError, match="'some-model' has no price"):
        panel.ask_sync(make.request())
    assert server.bodies == []


def uncounted(server, connection, body):
    """Answer without token counts."""
    whole = json.loads(answer_of(server.dialect, body["model"], GOOD))
    connection.sendall(http(200, json.dumps(whole | {"usage": None})))


@both
@pytest.mark.parametrize("script", [hangs, uncounted])
def test_late_and_uncounted_calls_are_recorded_at_their_bound(
    connect, make, dialect, script, tmp_path
):
    prices = tmp_path / "prices.yaml"
    prices.write_text("m: {input: 0, output: 1000}\n")
    options: dict[str, Any] = {"prices": prices, "reasoner": {"model": "m"}, "max_tokens": 512}
    limit = 0.2 if script is hangs else 10.0
    _, panel = connect(dialect, script, call_timeout_s=limit, **options)
    if script is hangs:
        with pytest.raises(ModelError, match="took longer"):
            panel.ask_sync(make.request())
    else:
        panel.ask_sync(make.request())
    assert panel.ledger.spent_usd == pytest.approx(0.512)


def test_concurrent_calls_are_limited(connect, make):
    def slow(server, connection, body):
        time.sleep(0.03)
        says()(server, connection, body)

    server, panel = connect("anthropic", slow, concurrency=3)
    ask_all(panel, [make.request(prompt=str(i)) for i in range(8)])
    assert server.most_at_once == 3


def test_canceled_requests_that_wait_are_not_sent_and_the_sent_one_is_paid(connect, make):
    arrived, go_on = threading.Event(), threading.Event()

    def held(server, connection, body):
        arrived.set()
        go_on.wait(10)
        says()(server, connection, body)

    server, panel = connect("anthropic", held, concurrency=1)
    futures = [panel.ask_soon(make.request(prompt=f"waits {i}")) for i in range(3)]
    assert arrived.wait(10)
    for future in futures:
        future.cancel()
    go_on.set()
    panel.ask_sync(make.request(prompt="after"))
    (first, last), texts = server.bodies, [f"waits {i}" for i in range(3)]
    assert sum(text in json.dumps(first) for text in texts) == 1 and "after" in json.dumps(last)
    assert panel.ledger.calls == 2


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

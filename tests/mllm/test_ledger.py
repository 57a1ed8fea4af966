"""The books: prices, what is unknown, and what carries over to a resumed run."""

import asyncio

import pytest

from neoworld_mjx.errors import ConfigError
from neoworld_mjx.mllm import Ledger, Price, Usage, load_prices
from neoworld_mjx.mllm.ledger import price_of, token_bound

PRICES = {"m": Price(input=1, output=10, cache_read=0.1, cache_write=2)}


def test_cost_counts_every_kind_of_token():
    price = PRICES["m"]
    assert price.cost(Usage(1_000_000)) == 1
    assert price.cost(Usage(output=1_000_000)) == 10
    assert price.cost(Usage(cache_read=1_000_000)) == pytest.approx(0.1)
    assert price.cost(Usage(cache_write=1_000_000)) == 2
    assert Price(input=3, output=0).cost(Usage(cache_read=10**6, cache_write=10**6)) == 6


@pytest.mark.parametrize(
    ("model", "found"),
    [
        ("m", True),
        ("m-20250929", True),
        ("m-latest", True),
        ("m-2024-08-06", True),
        ("m-mini", False),
        ("m-2", False),
        ("x", False),
    ],
)
def test_dated_names_have_the_price_of_their_model(model, found):
    assert (price_of(model, PRICES) is not None) == found


@pytest.mark.parametrize(
    ("text", "words"), [("m: {input: 1}", "m.output: Field required"), ("m: {", "not valid YAML")]
)
def test_invalid_prices_are_one_error(tmp_path, text, words):
    path = tmp_path / "p.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words) as caught:
        load_prices(path)
    assert str(path) in str(caught.value)
    with pytest.raises(ConfigError, match="cannot read prices"):
        load_prices(tmp_path / "none.yaml")


def test_unknown_price_is_unknown_cost():
    ledger = Ledger(None, PRICES)
    ledger.add("critic", "m", Usage(1_000_000))
    ledger.add("critic", "x", Usage(5))
    books = ledger.to_json()
    assert books["cost_usd"] is None
    assert books["known_cost_usd"] == 1
    assert books["models_without_price"] == ["x"]
    assert books["tokens"]["input"] == 1_000_005


async def reserve(ledger, request, max_tokens, then=lambda: None):
    async with ledger.reserve(request, "m", token_bound(request, max_tokens)):
        then()


def test_a_call_that_fits_only_alone_waits_for_others(make):
    ledger, order = Ledger(1.0, PRICES), []

    async def both():
        async with ledger.reserve(make.request(), "m", Usage(output=60_000)):
            waiting = asyncio.create_task(
                reserve(ledger, make.request(), 50_000, lambda: order.append("second"))
            )
            await asyncio.sleep(0)
            order.append("first")
        await waiting

    asyncio.run(both())
    assert order == ["first", "second"]

"""The loop of criticism and revision: its bounds, its order, and the failures that end it."""

import asyncio

import pytest

from neoworld_mjx.errors import BudgetError, MissingResponseError, ModelError
from neoworld_mjx.mllm import ask_or_record, revise
from tests.support.scripted_model import ScriptedModel


def run(rounds, *, accept_at=99, stop_at=99, critic=True, criticise_last=True):
    """Revise 0 to 1, 2, ...; return the attempts as (number, criticised)."""

    async def criticise(attempt):
        return attempt[0], True

    async def following(attempts):
        number = len(attempts)
        return None if number == stop_at else (number, False)

    return asyncio.run(
        revise(
            (0, False),
            rounds=rounds,
            accept=lambda attempt: attempt[0] >= accept_at,
            next_attempt=following,
            criticise=criticise if critic else None,
            criticise_last=criticise_last,
        )
    )


@pytest.mark.parametrize(
    ("options", "attempts"),
    [
        ({"rounds": 2}, [(0, True), (1, True), (2, True)]),
        ({"rounds": 2, "criticise_last": False}, [(0, True), (1, True), (2, False)]),
        ({"rounds": 2, "critic": False}, [(0, False), (1, False), (2, False)]),
        ({"rounds": 3, "accept_at": 1}, [(0, True), (1, True)]),
        ({"rounds": 3, "stop_at": 1}, [(0, True)]),
        ({"rounds": 0}, [(0, False)]),
    ],
)
def test_rounds_end_by_acceptance_failure_or_their_limit(options, attempts):
    assert run(**options) == attempts


def ask(answer, request):
    fallbacks: list[tuple[str, str]] = []
    model = ScriptedModel(answer)
    return asyncio.run(ask_or_record(model, request, "no judge round", fallbacks)), fallbacks


def test_a_failing_model_is_recorded_as_a_fallback(make):
    assert ask({"name": "red"}, make.request()) == (make.Colour(name="red"), [])
    assert ask(ModelError("down"), make.request()) == (None, [("no judge round", "down")])


@pytest.mark.parametrize("error", [BudgetError("cap"), MissingResponseError("tape")])
def test_budget_and_missing_response_errors_end_the_run(make, error):
    with pytest.raises(type(error)):
        ask(error, make.request())

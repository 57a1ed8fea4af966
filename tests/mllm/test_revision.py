"""The loop of criticism and revision: its bounds, its order, and the failures that end it."""

import asyncio

import pytest

from neoworld_mjx.mllm import revise


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

"""Loop of Steps 1 to 3: request a response, check it, criticize it, and request a revision.

The caller chooses the type of an attempt, which contains a response, the results of its checks and
its critique. The caller also supplies functions of an attempt:

- `criticise` adds a critic's verdict.
- `accept` decides whether the attempt needs no revision.
- `next_attempt` requests a revision and checks it.

The caller makes the first attempt; if this fails, there is no result. If a later request fails, the
rounds end, and the failure is recorded.
"""

from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

A = TypeVar("A")


async def revise(
    first: A,
    *,
    rounds: int,
    accept: Callable[[A], bool],
    next_attempt: Callable[[Sequence[A]], Awaitable[A | None]],
    criticise: Callable[[A], Awaitable[A]] | None = None,
    criticise_last: bool = True,
) -> list[A]:
    """Revise an attempt until an attempt is accepted or the rounds are used up.

    Args:
        first: the first attempt, with the results of its checks.
        rounds: maximum number of revisions. If 0, the first attempt is returned without a critique.
        accept: returns True if an attempt needs no revision.
        next_attempt: receives all attempts so far, and returns a revision of the last attempt with
            the results of its checks. If it returns None, the rounds end.
        criticise: returns an attempt with its critique. If None, attempts have no critique.
        criticise_last: if True, also criticize an attempt after which no round remains, for example
            to compare it with the other attempts.

    Returns:
        The attempts in order, with their critiques. The caller chooses the best attempt.
    """
    attempts: list[A] = []
    attempt: A | None = first
    for remaining in range(rounds, -1, -1):
        if criticise is not None and rounds and (remaining or criticise_last):
            attempt = await criticise(attempt)
        attempts.append(attempt)
        if not remaining or accept(attempt):
            break
        attempt = await next_attempt(attempts)
        if attempt is None:
            break
    return attempts

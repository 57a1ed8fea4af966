"""Loop of Steps 1 to 3: request a response, check it, criticise it, request a revision.

The caller supplies the steps as functions of its own attempt type, which contains a response, the
results of its checks and its critique: `criticise` adds a critic's verdict, `accept` decides if the
attempt needs no revision, `next_attempt` requests a revision and checks it. The caller also makes
the first attempt, without which there is no result. The failure of a later request ends the rounds
and is recorded.
"""

from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

from pydantic import BaseModel

from ..errors import BudgetError, MissingResponseError, ModelError
from .requests import Model, Request

A = TypeVar("A")
T = TypeVar("T", bound=BaseModel)
Fallback = tuple[str, str]
"""A skipped stage, and the reason."""


async def revise(
    first: A,
    *,
    rounds: int,
    accept: Callable[[A], bool],
    next_attempt: Callable[[Sequence[A]], Awaitable[A | None]],
    criticise: Callable[[A], Awaitable[A]] | None = None,
    criticise_last: bool = True,
) -> list[A]:
    """Revise an attempt until it is accepted or the rounds are used up.

    Args:
        first: the first attempt, with the results of its checks.
        rounds: maximum number of revisions; with 0, the first attempt is returned uncriticised.
        accept: returns True if an attempt needs no revision.
        next_attempt: receives all attempts so far and returns a revision of the last one, with the
            results of its checks; None ends the rounds.
        criticise: returns an attempt with its critique; None for loops whose checks suffice.
        criticise_last: True to also criticise an attempt after which no round remains, for example
            to compare it with the others.

    Returns:
        The attempts in order, with their critiques. The caller chooses the best of them.
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


async def ask_or_record(
    models: Model, request: Request[T], stage: str, fallbacks: list[Fallback]
) -> T | None:
    """Return a model's response; if the model fails, add a fallback and return None.

    Args:
        models: the models.
        request: an optional request.
        stage: name of the stage that a failure skips.
        fallbacks: list to which a failure adds the stage and the reason.

    Raises:
        BudgetError: the cost cap is reached.
        MissingResponseError: a tape lacks the response.
    """
    try:
        return (await models.ask(request)).value
    except (BudgetError, MissingResponseError):
        raise
    except ModelError as error:
        fallbacks.append((stage, str(error)))
        return None

"""The loop of Steps 1 to 3: ask a model, check its response, have it criticised, ask for a
revision.

A caller supplies the steps as functions over its own type of attempt, a response with the results
of its checks and its critique: `criticise` adds a critic's verdict, `accept` decides whether the
attempt needs no revision, `next_attempt` asks for a revision and checks it. The first attempt is
the caller's, since without it there is no result; every later request may fail, which ends the
rounds and is recorded.
"""

from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

from pydantic import BaseModel

from ..errors import BudgetError, MissingResponseError, ModelError
from .requests import Model, Request

A = TypeVar("A")
T = TypeVar("T", bound=BaseModel)
Fallback = tuple[str, str]
"""A stage that a result had to do without, and the reason."""


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
        first: the attempt to begin with, with the results of its checks.
        rounds: most revisions; with 0 the first attempt is returned without a critique.
        accept: whether an attempt needs no further revision.
        next_attempt: takes all attempts so far and returns a revision of the last one, with the
            results of its checks; None ends the rounds.
        criticise: returns an attempt with its critique; None for loops whose checks suffice.
        criticise_last: whether an attempt that no round is left to revise is criticised too, such
            as to compare it with the others.

    Returns:
        The attempts in order, with their critiques. The caller chooses the best of them.
    """
    attempts: list[A] = []
    attempt: A | None = first
    for left in range(rounds, -1, -1):
        if criticise is not None and rounds and (left or criticise_last):
            attempt = await criticise(attempt)
        attempts.append(attempt)
        if not left or accept(attempt):
            break
        attempt = await next_attempt(attempts)
        if attempt is None:
            break
    return attempts


async def ask_or_record(
    models: Model, request: Request[T], stage: str, fallbacks: list[Fallback]
) -> T | None:
    """Return a model's response; None if the model fails, which is added to the fallbacks.

    Args:
        models: answers the request.
        request: one that the result can do without.
        stage: names in the fallback the stage that is skipped.
        fallbacks: receives the stage and the reason of a failure.

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

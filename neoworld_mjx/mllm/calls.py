"""One call to a provider: inside the limits, tried again where that may help, booked.

Here too is the border that no key crosses: whatever a provider raises leaves scrubbed.
"""

import asyncio
import random
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ..config import MLLMOptions, RoleOptions
from ..errors import ModelError
from .ledger import Ledger, most_tokens
from .model import Provider, Rejection, Reply, Request, Transient, Usage
from .secrets import scrub

_LONGEST_BACKOFF_S = 30.0
_BATCH_SHARE = 0.5
"""Part of the list price that a batch is billed at."""


class Calls:
    """Makes calls under the options' limits.

    Args:
        provider: who answers.
        options: retries, concurrency and time limit.
        ledger: the books.
        backoff_s: first wait after a failed call, in seconds; it doubles from call to call.
    """

    def __init__(
        self, provider: Provider, options: MLLMOptions, ledger: Ledger, backoff_s: float
    ) -> None:
        self.provider = provider
        self.options = options
        self.ledger = ledger
        self.backoff_s = backoff_s
        self._gate = asyncio.Semaphore(options.concurrency)
        self._settled = asyncio.Condition()

    async def make(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Get one reply, not yet validated.

        Raises:
            BudgetError: the call could exceed the cost cap; nothing was sent.
            ModelError: no reply could be had.
        """
        if not self.provider.online:
            reply = await self._guarded(request, role, rejected)
            self.ledger.add(request.role, reply.model, reply.usage, billed=False)
            return reply
        failure = Transient("not asked")
        for attempt in range(self.options.retries + 1):
            if attempt:
                await asyncio.sleep(self._delay(request, attempt, failure))
            try:
                async with self._gate:
                    return await self._booked(request, role, rejected)
            except Transient as error:
                failure = error
        tries = self.options.retries + 1
        raise self.error(
            f"{request.name}: {self.provider.name} did not answer in {tries} "
            f"{'try' if tries == 1 else 'tries'}; the last one: {failure}. Resume the run later, "
            f"or raise mllm.retries or mllm.timeout_s"
        )

    async def _booked(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        most = most_tokens(request, role.max_tokens, rejected)
        bound = self.ledger.bound(role.model, most)
        async with self._held(request, bound):
            try:
                reply = await self._guarded(request, role, rejected)
            except Transient as error:
                self.ledger.add(request.role, role.model, error.usage, failed=True)
                raise
            except ModelError:
                self.ledger.add(request.role, role.model, Usage(), failed=True)
                raise
            if not reply.counted:
                reply = replace(reply, usage=most)
            self.ledger.add(request.role, role.model, reply.usage)
        if reply.fallback is not None:
            self.ledger.fell_back(reply.fallback)
        return reply

    async def _guarded(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Call the provider; let nothing out that could show a key."""
        try:
            return await self.provider.reply(request, role, rejected)
        except Transient as error:
            clean = scrub(str(error), self.provider.secrets)
            raise Transient(clean, error.retry_after, error.usage) from None
        except ModelError as error:
            raise type(error)(scrub(str(error), self.provider.secrets)) from None
        except Exception as error:
            what = f"{type(error).__name__}: {error}"
            raise self.error(f"{request.name}: {self.provider.name} failed: {what}") from None

    def _held(self, request: Request[Any], bound: float) -> "_Held":
        return _Held(self.ledger, self._settled, request, bound)

    def _delay(self, request: Request[Any], attempt: int, failure: Transient) -> float:
        if failure.retry_after is None:
            wait = min(self.backoff_s * 2 ** (attempt - 1), _LONGEST_BACKOFF_S)
            return wait * random.uniform(0.5, 1.0)  # spread, so that calls do not return as one
        longest = max(self.options.timeout_s, 60.0)
        if failure.retry_after > longest:
            raise self.error(
                f"{request.name}: {self.provider.name} asks to wait {failure.retry_after:.0f} s, longer "
                f"than a run waits ({longest:.0f} s): {failure}. Resume the run later"
            )
        return failure.retry_after

    def error(self, message: str) -> ModelError:
        """Make an error that shows no key."""
        return ModelError(scrub(message, self.provider.secrets))

    async def batch(
        self, requests: Sequence[Request[Any]], roles: Sequence[RoleOptions]
    ) -> list[Reply | None]:
        """Send requests as one batch, if the provider has batches; None where it gave no reply.

        Raises:
            BudgetError: the batch could exceed the cost cap; nothing was sent.
            ModelError: the batch failed as a whole.
        """
        send = getattr(self.provider, "batch", None)
        if send is None or not requests:
            return [None] * len(requests)
        asked = list(zip(requests, roles, strict=True))
        bound = _BATCH_SHARE * sum(
            self.ledger.bound(role.model, most_tokens(request, role.max_tokens))
            for request, role in asked
        )
        async with self._held(requests[0], bound):
            try:
                replies: list[Reply | None] = await send(asked)
            except ModelError as error:
                raise type(error)(scrub(str(error), self.provider.secrets)) from None
            for (request, role), reply in zip(asked, replies, strict=True):
                if reply is not None:
                    self.ledger.add(request.role, role.model, reply.usage, share=_BATCH_SHARE)
                    if reply.fallback is not None:
                        self.ledger.fell_back(reply.fallback)
        return replies


class _Held:
    """Holds a call's highest cost against the cap while the call is under way."""

    def __init__(
        self, ledger: Ledger, settled: asyncio.Condition, request: Request[Any], bound: float
    ) -> None:
        self._ledger, self._settled = ledger, settled
        self._request, self._bound = request, bound

    async def __aenter__(self) -> None:
        async with self._settled:
            while not self._ledger.fits(self._bound):
                # Calls under way mostly cost less than is held for them: wait before giving up.
                if not self._ledger.reserved_usd or not self._ledger.fits(
                    self._bound, others=False
                ):
                    raise self._ledger.refuse(self._request, self._bound)
                await self._settled.wait()
            self._ledger.hold(self._bound)

    async def __aexit__(self, *exc: object) -> None:
        async with self._settled:
            self._ledger.release(self._bound)
            self._settled.notify_all()

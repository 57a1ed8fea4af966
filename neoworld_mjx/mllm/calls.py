"""Calls to a provider: within the limits, retried where that may help, and booked.

Every error of a provider is scrubbed of keys here.
"""

import asyncio
import random
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from typing import Any

from ..config import MLLMOptions, RoleOptions
from ..errors import ModelError
from ..progress import update
from .ledger import Ledger, most_tokens
from .requests import Provider, Rejection, Reply, Request, Transient, Usage
from .secrets import scrub

_LONGEST_BACKOFF_S = 30.0
_BATCH_SHARE = 0.5
"""Fraction of the list price that a batch is billed at."""


class Calls:
    """Makes calls under the options' limits.

    Args:
        provider: the source of responses.
        options: retries, concurrency and time limit.
        ledger: books every call.
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
        self._released = asyncio.Condition()
        self._unanswered, self._since, self._waited_s = 0, 0.0, 0.0

    @property
    def waited_s(self) -> float:
        """Seconds so far in which at least one call was unanswered."""
        return self._waited_s + (time.perf_counter() - self._since if self._unanswered else 0.0)

    @contextmanager
    def _waiting(self) -> Iterator[None]:
        if not self._unanswered:
            self._since = time.perf_counter()
        self._unanswered += 1
        self._report()
        try:
            yield
        finally:
            waited = self.waited_s
            self._unanswered -= 1
            if not self._unanswered:
                self._waited_s = waited
            self._report()

    def _report(self) -> None:
        ledger = self.ledger
        update(calls=ledger.calls, cost_usd=ledger.spent_usd, unanswered=self._unanswered)

    async def make(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Get one reply, not yet validated.

        Raises:
            BudgetError: the call could exceed the cost cap; nothing was sent.
            ModelError: the provider gave no reply.
        """
        if not self.provider.online:
            with self._waiting():
                reply = await self._guarded(request, role, rejected)
            self.ledger.add(request.role, reply.model, reply.usage, billed=False)
            return reply
        await asyncio.to_thread(request.draw_pictures)
        with self._waiting():
            return await self._retried(request, role, rejected)

    async def _retried(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
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
        async with self._reserved(request, bound):
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
        """Call the provider; scrub keys from every error."""
        try:
            return await self.provider.reply(request, role, rejected)
        except Transient as error:
            clean = scrub(str(error), self.provider.secrets)
            raise Transient(clean, error.retry_after, error.usage) from None
        except ModelError as error:
            raise type(error)(scrub(str(error), self.provider.secrets)) from None
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise self.error(f"{request.name}: {self.provider.name} failed: {reason}") from None

    @asynccontextmanager
    async def _reserved(self, request: Request[Any], bound: float) -> AsyncIterator[None]:
        """Reserve a call's highest cost while it is under way.

        Raises:
            BudgetError: the call could exceed the cost cap.
        """
        ledger = self.ledger
        async with self._released:
            while not ledger.fits(bound):
                # Calls under way mostly cost less than their reservation: wait before giving up.
                if not ledger.reserved_usd or not ledger.fits(bound, others=False):
                    raise ledger.refuse(request, bound)
                await self._released.wait()
            ledger.hold(bound)
        try:
            yield
        finally:
            async with self._released:
                ledger.release(bound)
                self._released.notify_all()

    def _delay(self, request: Request[Any], attempt: int, failure: Transient) -> float:
        if failure.retry_after is None:
            wait = min(self.backoff_s * 2 ** (attempt - 1), _LONGEST_BACKOFF_S)
            return wait * random.uniform(0.5, 1.0)  # spread, so that calls do not return as one
        longest = max(self.options.timeout_s, 60.0)
        if failure.retry_after > longest:
            raise self.error(
                f"{request.name}: {self.provider.name} asks to wait {failure.retry_after:.0f} s, "
                f"longer than a run waits ({longest:.0f} s): {failure}. Resume the run later"
            )
        return failure.retry_after

    def error(self, message: str) -> ModelError:
        """Return an error without keys in its message."""
        return ModelError(scrub(message, self.provider.secrets))

    async def batch(
        self, requests: Sequence[Request[Any]], roles: Sequence[RoleOptions]
    ) -> list[Reply | None]:
        """Send requests as one batch; None where it gave no reply or the provider has no batches.

        Raises:
            BudgetError: the batch could exceed the cost cap; nothing was sent.
            ModelError: the batch failed as a whole.
        """
        send = getattr(self.provider, "batch", None)
        if send is None or not requests:
            return [None] * len(requests)
        for request in requests:
            await asyncio.to_thread(request.draw_pictures)
        calls = list(zip(requests, roles, strict=True))
        bound = _BATCH_SHARE * sum(
            self.ledger.bound(role.model, most_tokens(request, role.max_tokens))
            for request, role in calls
        )
        async with self._reserved(requests[0], bound):
            try:
                with self._waiting():
                    replies: list[Reply | None] = await send(calls)
            except ModelError as error:
                raise type(error)(scrub(str(error), self.provider.secrets)) from None
            for (request, role), reply in zip(calls, replies, strict=True):
                if reply is not None:
                    self.ledger.add(request.role, role.model, reply.usage, share=_BATCH_SHARE)
                    if reply.fallback is not None:
                        self.ledger.fell_back(reply.fallback)
        return replies

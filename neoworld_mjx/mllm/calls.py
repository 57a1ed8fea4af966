"""Calls to a provider, with limits, retries and accounting.

All errors of a provider pass through this module, which removes keys from their messages.
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
from .ledger import Ledger, token_bound
from .requests import Provider, Rejection, Reply, Request, Transient, Usage
from .secrets import scrub

_LONGEST_BACKOFF_S = 30.0
_BATCH_SHARE = 0.5
"""Price of a request in a batch, as a fraction of the list price."""


class Calls:
    """Calls a provider within the limits of the options.

    Args:
        provider: the source of responses.
        options: retries, concurrency and time limit.
        ledger: ledger of the calls.
        backoff_s: delay before the first retry of a call [s]; it doubles with every further retry.
    """

    def __init__(
        self, provider: Provider, options: MLLMOptions, ledger: Ledger, backoff_s: float
    ) -> None:
        self.provider = provider
        self.options = options
        self.ledger = ledger
        self.backoff_s = backoff_s
        self._slots = asyncio.Semaphore(options.concurrency)
        self._released = asyncio.Condition()
        self._in_flight, self._since, self._waited_s = 0, 0.0, 0.0

    @property
    def waited_s(self) -> float:
        """Total time during which at least one call was in progress [s]."""
        return self._waited_s + (time.perf_counter() - self._since if self._in_flight else 0.0)

    @contextmanager
    def _waiting(self) -> Iterator[None]:
        if not self._in_flight:
            self._since = time.perf_counter()
        self._in_flight += 1
        self._report()
        try:
            yield
        finally:
            waited = self.waited_s
            self._in_flight -= 1
            if not self._in_flight:
                self._waited_s = waited
            self._report()

    def _report(self) -> None:
        ledger = self.ledger
        update(calls=ledger.calls, cost_usd=ledger.spent_usd, unanswered=self._in_flight)

    async def make(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Return one reply, which is not validated yet.

        Raises:
            BudgetError: the call could exceed the cost cap; nothing was sent.
            ModelError: the provider gave no reply.
        """
        if not self.provider.online:
            with self._waiting():
                reply = await self._call_provider(request, role, rejected)
            self.ledger.add(request.role, reply.model, reply.usage, billed=False)
            return reply
        await asyncio.to_thread(request.encode_pictures)
        with self._waiting():
            return await self._call_with_retries(request, role, rejected)

    async def _call_with_retries(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        failure = Transient("no call was made")
        left_s = self.options.call_timeout_s
        for attempt in range(self.options.retries + 1):
            if attempt:
                await asyncio.sleep(self._delay(request, attempt, failure))
            async with self._slots:
                start = time.perf_counter()
                try:
                    return await self._call_and_record(request, role, rejected, left_s)
                except Transient as error:
                    failure = error
                left_s -= time.perf_counter() - start
        tries = self.options.retries + 1
        raise self.error(
            f"{request.name}: {self.provider.name} did not answer in {tries} "
            f"{'try' if tries == 1 else 'tries'}; the last one: {failure}. Resume the run later, "
            f"or raise mllm.retries or mllm.timeout_s"
        )

    async def _call_and_record(
        self,
        request: Request[Any],
        role: RoleOptions,
        rejected: Sequence[Rejection],
        left_s: float,
    ) -> Reply:
        tokens = token_bound(request, role.max_tokens, rejected)
        bound_usd = self.ledger.cost_bound(role.model, tokens)
        async with self._reserved(request, bound_usd):
            try:
                async with asyncio.timeout(left_s):
                    reply = await self._call_provider(request, role, rejected)
            except TimeoutError:
                # The server may bill the tokens that it has sent so far.
                self.ledger.add(request.role, role.model, tokens, failed=True)
                raise self.error(
                    f"{request.name}: {self.provider.name} took longer than "
                    f"{self.options.call_timeout_s:g} s including retries; resume the run later, "
                    "or raise mllm.call_timeout_s"
                ) from None
            except Transient as error:
                self.ledger.add(request.role, role.model, error.usage, failed=True)
                raise
            except ModelError:
                self.ledger.add(request.role, role.model, Usage(), failed=True)
                raise
            if not reply.counted:
                reply = replace(reply, usage=tokens)
            self.ledger.add(request.role, role.model, reply.usage)
        if reply.fallback is not None:
            self.ledger.add_fallback(reply.fallback)
        return reply

    async def _call_provider(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Call the provider, and remove keys from the message of any error."""
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
    async def _reserved(self, request: Request[Any], bound_usd: float) -> AsyncIterator[None]:
        """Reserve the maximum cost of a call while it is in progress.

        Raises:
            BudgetError: the call could exceed the cost cap.
        """
        ledger = self.ledger
        async with self._released:
            while not ledger.fits(bound_usd):
                # Most calls cost less than their reservation: wait for other calls to end.
                if not ledger.reserved_usd or not ledger.fits(bound_usd, others=False):
                    raise ledger.cap_error(request, bound_usd)
                await self._released.wait()
            ledger.reserve(bound_usd)
        try:
            yield
        finally:
            async with self._released:
                ledger.release(bound_usd)
                self._released.notify_all()

    def _delay(self, request: Request[Any], attempt: int, failure: Transient) -> float:
        if failure.retry_after is None:
            wait = min(self.backoff_s * 2 ** (attempt - 1), _LONGEST_BACKOFF_S)
            return wait * random.uniform(0.5, 1.0)  # Jitter, so that calls do not retry in unison.
        longest = max(self.options.timeout_s, 60.0)
        if failure.retry_after > longest:
            raise self.error(
                f"{request.name}: {self.provider.name} asks to wait {failure.retry_after:.0f} s, "
                f"longer than a run waits ({longest:.0f} s): {failure}. Resume the run later"
            )
        return failure.retry_after

    def error(self, message: str) -> ModelError:
        """Return an error with this message, from which keys are removed."""
        return ModelError(scrub(message, self.provider.secrets))

    async def batch(
        self, requests: Sequence[Request[Any]], roles: Sequence[RoleOptions]
    ) -> list[Reply | None]:
        """Send requests as one batch.

        Returns:
            The reply to each request. None if the batch gave no reply, or if the provider has no
            batches.

        Raises:
            BudgetError: the batch could exceed the cost cap; nothing was sent.
            ModelError: the batch failed as a whole.
        """
        send = getattr(self.provider, "batch", None)
        if send is None or not requests:
            return [None] * len(requests)
        for request in requests:
            await asyncio.to_thread(request.encode_pictures)
        calls = list(zip(requests, roles, strict=True))
        bound_usd = _BATCH_SHARE * sum(
            self.ledger.cost_bound(role.model, token_bound(request, role.max_tokens))
            for request, role in calls
        )
        async with self._reserved(requests[0], bound_usd):
            try:
                with self._waiting():
                    replies: list[Reply | None] = await send(calls)
            except ModelError as error:
                raise type(error)(scrub(str(error), self.provider.secrets)) from None
            for (request, role), reply in zip(calls, replies, strict=True):
                if reply is not None:
                    self.ledger.add(request.role, role.model, reply.usage, share=_BATCH_SHARE)
                    if reply.fallback is not None:
                        self.ledger.add_fallback(reply.fallback)
        return replies

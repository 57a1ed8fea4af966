"""Panel of models: a provider with routing, limits, validation, accounting and recording.

For each request, the panel

- chooses the model of the request's role,
- enforces the concurrency limit, the deadline and the cost cap,
- sends an invalid response back to the model with the error, a limited number of times,
- adds every call to the ledger, and records every response.

A panel runs its own event loop in a thread. It therefore works in synchronous code (`ask_sync`)
and in any event loop (`ask`), even in several loops one after another. Keys of model
servers are read only from the environment, and removed from all output.
"""

import asyncio
import concurrent.futures
import contextvars
import os
import re
import threading
import time
from collections.abc import Coroutine, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from ..config import MLLMOptions, RoleOptions
from ..errors import ModelError
from ..progress import update
from .ledger import Ledger, load_prices, token_bound
from .replay import Tape
from .requests import (
    InvalidResponse,
    Provider,
    Rejection,
    Reply,
    Request,
    Response,
    Usage,
    read_response,
)

Returned = TypeVar("Returned")


def run_coroutine(work: Coroutine[Any, Any, Returned]) -> Returned:
    """Run a coroutine and return its result; the call blocks.

    Inside a running event loop, the coroutine runs on a separate loop in another thread. It sees
    the caller's context variables in both cases.
    """
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(work)
    with ThreadPoolExecutor(1, thread_name_prefix="neoworld-steps") as thread:
        return thread.submit(contextvars.copy_context().run, asyncio.run, work).result()


_KEY_PATTERNS = re.compile(
    r"(?i)\bbearer\s+[^\s'\",;]+|\bsk-[A-Za-z0-9_-]{8,}|(?<=://)[^/@\s]+(?=@)"
)
_PLACEHOLDER = "[key]"


def environment_key(name: str) -> str | None:
    """Return the key in an environment variable; None if the variable is unset or blank."""
    return os.environ.get(name, "").strip() or None


def hide(text: str, secrets: Iterable[str]) -> str:
    """Replace the given secrets in a text by a placeholder."""
    for secret in sorted(secrets, key=len, reverse=True):
        if len(secret) >= 4:
            text = text.replace(secret, _PLACEHOLDER)
    return text


def scrub(text: str, secrets: Iterable[str]) -> str:
    """Replace the given secrets, and everything that looks like a key, by a placeholder."""
    return _KEY_PATTERNS.sub(_PLACEHOLDER, hide(text, secrets))


T = TypeVar("T", bound=BaseModel)

CORRECTIONS = 3
"""Maximum number of times that an invalid response is sent back to the model with the error."""


class Panel:
    """Models for the roles of reasoner, programmer and critic.

    Args:
        provider: the source of responses.
        options: models, limits and cap.
        record: file of recorded responses (a tape). The panel writes every response to the tape
            immediately, and sends no request whose response the tape contains. An interrupted run
            therefore loses no response.
        photo: sha256 of the photo's file, written to the tape.
        made: origin of the responses, written to the tape.

    Raises:
        ConfigError: the table of prices is invalid.
        ModelError: the tape `record` cannot be read or belongs to another photo.
    """

    def __init__(
        self,
        provider: Provider,
        options: MLLMOptions | None = None,
        *,
        record: Path | None = None,
        photo: str | None = None,
        made: str = "",
    ) -> None:
        self.provider = provider
        self.options = options or MLLMOptions()
        self.ledger = Ledger(self.options.max_cost_usd, load_prices(self.options.prices))
        self._record = Path(record) if record is not None else None
        self._tape = _open_record(self._record, photo, made)
        self._slots = asyncio.Semaphore(self.options.concurrency)
        self._tasks: set[asyncio.Task[Any]] = set()
        self._sent: set[asyncio.Task[Any]] = set()
        """Tasks whose request has been sent, for which money may be due."""
        self._in_flight, self._since, self._waited_s = 0, 0.0, 0.0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    @property
    def waited_s(self) -> float:
        """Total time during which at least one request waited for the provider [s]."""
        return self._waited_s + (time.perf_counter() - self._since if self._in_flight else 0.0)

    @property
    def name(self) -> str:
        """The provider's name, such as "replay" or "anthropic"."""
        return self.provider.name

    async def ask(self, request: Request[T]) -> Response[T]:
        """Return the response to a request.

        Raises:
            MissingResponseError: the provider replays a tape that does not contain the response.
            BudgetError: the call could exceed the cost cap; nothing was sent.
            ModelError: there is no valid response for any other reason.
        """
        return await asyncio.wrap_future(self.ask_soon(request))

    def ask_soon(self, request: Request[T]) -> "concurrent.futures.Future[Response[T]]":
        """Return a future of the response, from any thread.

        If the future is canceled, a request that has been sent continues, so that a paid response
        is recorded; one that waits for another to end is not sent.
        """
        with self._lock:
            if self._loop is None:
                self._loop = asyncio.new_event_loop()
                self._thread = threading.Thread(
                    target=self._loop.run_forever, name="neoworld-mllm", daemon=True
                )
                self._thread.start()
            return asyncio.run_coroutine_threadsafe(self._shielded(request), self._loop)

    def ask_sync(self, request: Request[T]) -> Response[T]:
        """Return the response to a request, in code without an event loop."""
        return self.ask_soon(request).result()

    def close(self) -> None:
        """Close connections and stop the panel's thread; a later request starts a new one."""
        with self._lock:
            loop, thread = self._loop, self._thread
            self._loop = self._thread = None
        if loop is None or thread is None:
            return
        asyncio.run_coroutine_threadsafe(self._shut_down(), loop).result(timeout=5)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(timeout=5)
        loop.close()

    def __enter__(self) -> "Panel":
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    async def _shut_down(self) -> None:
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self.provider.close()

    async def _shielded(self, request: Request[T]) -> Response[T]:
        task = asyncio.ensure_future(self._respond(request))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(self._sent.discard)
        try:
            return await asyncio.shield(task)
        except asyncio.CancelledError:
            if task not in self._sent:
                task.cancel()
            raise

    async def _respond(self, request: Request[T]) -> Response[T]:
        recorded = self._tape.get(request) if self._record is not None else None
        if recorded is not None:
            try:
                value = read_response(recorded.text, request.schema)
                return Response(value, recorded.text, Usage(), recorded.model)
            except InvalidResponse:
                pass  # Validators may have changed although the JSON schema has not.
        return await self._request_until_valid(request)

    async def _request_until_valid(self, request: Request[T]) -> Response[T]:
        """Send a request; send invalid responses back with the errors for a few rounds."""
        role: RoleOptions = getattr(self.options, request.role)
        rejected: tuple[Rejection, ...] = ()
        rounds = 1 + (CORRECTIONS if self.provider.online else 0)
        usage = Usage()
        model, reason = role.model, ""
        while len(rejected) < rounds:
            reply = await self._call(request, role, rejected)
            model, usage = reply.model, usage + (reply.usage or Usage())
            self._check_stop(request, reply)
            try:
                value = read_response(reply.text, request.schema)
            except InvalidResponse as error:
                reason = str(error)
                rejected = (*rejected, Rejection(reply.text, reason))
                continue
            if self._record is not None:
                self._tape.put(request, hide(reply.text, self.provider.secrets), model)
                self._tape.save(self._record)
            return Response(value, reply.text, usage, model)
        raise self._error(
            f"{request.name}: {model} gave no valid response in {rounds} "
            f"{'try' if rounds == 1 else 'tries'}; the last one: {reason}"
        )

    async def _call(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Make a call within the limits, and add it to the ledger."""
        task = asyncio.current_task()
        assert task is not None
        if not self.provider.online:
            self._sent.add(task)
            with self._waiting():
                reply = await self._reply(request, role, rejected)
            self.ledger.add(request.role, reply.model, reply.usage or Usage(), billed=False)
            return reply
        bound = token_bound(request, self.options.max_tokens, rejected)
        limit_s = self.options.call_timeout_s
        with self._waiting():
            async with self._slots, self.ledger.reserve(request, role.model, bound):
                spent, failed = Usage(), True
                self._sent.add(task)
                try:
                    async with asyncio.timeout(limit_s):
                        reply = await self._reply(request, role, rejected)
                    # A server that does not count tokens may bill up to the bound.
                    spent, failed = reply.usage or bound, False
                    return reply
                except TimeoutError:
                    spent = bound  # The server may bill the tokens that it has generated.
                    raise self._error(
                        f"{request.name}: {self.name} took longer than {limit_s:g} s including "
                        "retries; resume the run later, or raise mllm.call_timeout_s"
                    ) from None
                finally:
                    self.ledger.add(request.role, role.model, spent, failed=failed)

    async def _reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Call the provider, and remove keys from the message of any error."""
        try:
            return await self.provider.reply(request, role, rejected)
        except ModelError as error:
            raise type(error)(scrub(str(error), self.provider.secrets)) from None
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise self._error(f"{request.name}: {self.name} failed: {reason}") from None

    def _check_stop(self, request: Request[Any], reply: Reply) -> None:
        if reply.stop == "refusal":
            reason = f": {reply.detail}" if reply.detail else ""
            raise self._error(
                f"{request.name}: {reply.model} refused to answer{reason}; "
                f"try another photo or another model (mllm.{request.role}.model)"
            )
        if reply.stop == "length":
            raise self._error(
                f"{request.name}: the response of {reply.model} was cut off at "
                f"{self.options.max_tokens} tokens; raise mllm.max_tokens"
            )

    def _error(self, message: str) -> ModelError:
        """Return an error with this message, from which keys are removed."""
        return ModelError(scrub(message, self.provider.secrets))

    @contextmanager
    def _waiting(self) -> Iterator[None]:
        """Count the time of a call, and update the status line."""
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


def _open_record(path: Path | None, photo: str | None, made: str) -> Tape:
    if path is None or not path.exists():
        return Tape(format=1, photo=photo, made=made)
    tape = Tape.load(path)
    if photo is not None and tape.photo not in (None, photo):
        raise ModelError(f"tape {path} was recorded for another photo; record to another file")
    tape.photo = tape.photo or photo
    tape.made = made or tape.made
    return tape

"""Panel of models: a provider with routing, limits, retries, validation and recording.

For each request, the panel

- chooses the model of the request's role,
- enforces the concurrency limit and the cost cap,
- retries failed calls,
- sends an invalid response back to the model with the error, a limited number of times,
- adds every call to the ledger, and records every response.

A panel runs its own event loop in a thread. It therefore works in synchronous code (`ask_sync`,
`ask_many`, `run`) and in any event loop (`ask`), even in several loops one after another.
"""

import asyncio
import concurrent.futures
import threading
from collections.abc import Coroutine, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from ..config import MLLMOptions, RoleOptions
from ..errors import ModelError
from .calls import Calls
from .ledger import Ledger, load_prices
from .replay import Tape
from .requests import Provider, Rejection, Reply, Request, Response, Usage
from .responses import InvalidResponse, read_response
from .secrets import hide

T = TypeVar("T", bound=BaseModel)
R = TypeVar("R")


class Panel:
    """Models for the roles of reasoner, programmer and critic.

    Args:
        provider: the source of responses.
        options: models, limits and cap.
        ledger: ledger of the calls. If None, a new ledger with the cap and the prices of `options`.
        record: file of recorded responses (a tape). The panel writes every response to the tape
            immediately, and sends no request whose response the tape contains. An interrupted run
            therefore loses no response.
        photo: sha256 of the photo's file, written to the tape.
        made: origin of the responses, written to the tape.
        backoff_s: delay before the first retry of a call [s]; it doubles with every further retry.

    Raises:
        ConfigError: the table of prices is invalid.
        ModelError: the tape `record` cannot be read or belongs to another photo.
    """

    def __init__(
        self,
        provider: Provider,
        options: MLLMOptions | None = None,
        *,
        ledger: Ledger | None = None,
        record: Path | None = None,
        photo: str | None = None,
        made: str = "",
        backoff_s: float = 0.5,
    ) -> None:
        self.provider = provider
        self.options = options or MLLMOptions()
        self.ledger = ledger or Ledger(self.options.max_cost_usd, load_prices(self.options.prices))
        self._record = Path(record) if record is not None else None
        self._tape = _open_record(self._record, photo, made)
        self._calls = Calls(provider, self.options, self.ledger, backoff_s)
        self._tasks: dict[tuple[str, type], asyncio.Task[Response[Any]]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    @property
    def waited_s(self) -> float:
        """Total time during which at least one request waited for the provider [s]."""
        return self._calls.waited_s

    @property
    def name(self) -> str:
        """The provider's name, such as "replay" or "anthropic"."""
        return self.provider.name

    async def ask(self, request: Request[T]) -> Response[T]:
        """Return the response to a request.

        Requests may be concurrent; equal requests are sent once.

        Raises:
            MissingResponseError: the provider replays a tape that does not contain the response.
            BudgetError: the call could exceed the cost cap; nothing was sent.
            ModelError: there is no valid response for any other reason.
        """
        return await asyncio.wrap_future(self._submit(self._shared(request)))

    def ask_soon(self, request: Request[T]) -> "concurrent.futures.Future[Response[T]]":
        """Return a future of the response, from any thread; canceling it cancels no request."""
        return self._submit(self._shared(request))

    def ask_sync(self, request: Request[T]) -> Response[T]:
        """Return the response to a request, in code without an event loop."""
        return self.run(self._shared(request))

    def ask_many(self, requests: Sequence[Request[T]]) -> list[Response[T]]:
        """Send requests concurrently; return the responses in the order of the requests.

        If a request fails, the call still waits for the others, so that no paid response is lost.

        Raises:
            ModelError: the first failure in the order of the requests; see `ask`.
        """
        return self.run(self._gather(requests))

    def batch(self, requests: Sequence[Request[T]]) -> list[Response[T]]:
        """Send requests as one batch if the provider has batches, and return all responses.

        A batch costs less than single calls but may take up to a day. A request for which the batch
        gives no valid response is sent individually.

        Raises:
            ModelError: the first failure in the order of the requests; see `ask`.
        """
        return self.run(self._batch(requests))

    def run(self, work: Coroutine[Any, Any, R]) -> R:
        """Run a coroutine on the panel's event loop and wait for its result.

        The caller's thread may run an event loop, but not the panel's event loop.
        """
        future = self._submit(work)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

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

    def _submit(self, work: Coroutine[Any, Any, R]) -> "concurrent.futures.Future[R]":
        with self._lock:
            if self._loop is None:
                self._loop = asyncio.new_event_loop()
                self._thread = threading.Thread(
                    target=self._loop.run_forever, name="neoworld-mllm", daemon=True
                )
                self._thread.start()
            return asyncio.run_coroutine_threadsafe(work, self._loop)

    async def _shut_down(self) -> None:
        for task in self._tasks.values():
            task.cancel()
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)
        self._tasks.clear()
        await self.provider.close()

    async def _gather(self, requests: Sequence[Request[T]]) -> list[Response[T]]:
        results = await asyncio.gather(*map(self._shared, requests), return_exceptions=True)
        responses = []
        for result in results:
            if isinstance(result, BaseException):
                raise result
            responses.append(result)
        return responses

    async def _shared(self, request: Request[T]) -> Response[T]:
        """Return the response to a request; equal requests share one task."""
        identity = (request.key, request.schema)
        task = self._tasks.get(identity)
        if task is None:
            task = asyncio.ensure_future(self._respond(request))
            self._tasks[identity] = task
            task.add_done_callback(lambda done: self._forget_failure(identity, done))
        # If one caller is canceled, the other callers still need the response.
        return await asyncio.shield(task)

    def _forget_failure(self, identity: tuple[str, type], done: "asyncio.Task[Any]") -> None:
        if done.cancelled() or done.exception() is not None:
            self._tasks.pop(identity, None)

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
        role = self._role(request)
        rejected: tuple[Rejection, ...] = ()
        rounds = 1 + (self.options.validation_rounds if self.provider.online else 0)
        usage = Usage()
        model, reason = role.model, ""
        while len(rejected) < rounds:
            reply = await self._calls.make(request, role, rejected)
            usage = usage + reply.usage
            self._check_stop(request, role, reply)
            try:
                value = read_response(reply.text, request.schema)
            except InvalidResponse as error:
                model, reason = reply.model, str(error)
                rejected = (*rejected, Rejection(reply.text, reason))
                continue
            self._write_record(request, reply)
            return Response(value, reply.text, usage, reply.model)
        error = self._calls.error(
            f"{request.name}: {model} gave no valid response in {rounds} "
            f"{'try' if rounds == 1 else 'tries'}; the last one: {reason}"
        )
        error.texts = tuple(hide(r.text, self.provider.secrets) for r in rejected)
        raise error

    def _check_stop(self, request: Request[Any], role: RoleOptions, reply: Reply) -> None:
        if reply.stop == "refusal":
            reason = f": {reply.detail}" if reply.detail else ""
            error = self._calls.error(
                f"{request.name}: {reply.model} refused to answer{reason}; "
                f"try another photo or another model (mllm.{request.role}.model)"
            )
            error.texts = (hide(reply.text, self.provider.secrets),)
            raise error
        if reply.stop == "length":
            raise self._calls.error(
                f"{request.name}: the response of {reply.model} was cut off at {role.max_tokens} "
                f"tokens; raise mllm.{request.role}.max_tokens"
            )

    def _write_record(self, request: Request[Any], reply: Reply) -> None:
        if self._record is not None:
            self._tape.put(request, hide(reply.text, self.provider.secrets), reply.model)
            self._tape.save(self._record)

    def _role(self, request: Request[Any]) -> RoleOptions:
        return getattr(self.options, request.role)

    async def _batch(self, requests: Sequence[Request[T]]) -> list[Response[T]]:
        new = {r.key: r for r in requests if (r.key, r.schema) not in self._tasks}
        waiting = [r for r in new.values() if self._record is None or self._tape.get(r) is None]
        roles = [self._role(request) for request in waiting]
        for request, reply in zip(waiting, await self._calls.batch(waiting, roles), strict=True):
            if reply is None or reply.stop != "end":
                continue
            try:
                value = read_response(reply.text, request.schema)
            except InvalidResponse:
                continue  # Sent individually below.
            self._write_record(request, reply)
            response = Response(value, reply.text, reply.usage, reply.model)
            self._tasks[request.key, request.schema] = asyncio.ensure_future(_ready(response))
        return await self._gather(requests)


async def _ready(response: Response[T]) -> Response[T]:
    return response


def _open_record(path: Path | None, photo: str | None, made: str) -> Tape:
    if path is None or not path.exists():
        return Tape(format=1, photo=photo, made=made)
    tape = Tape.load(path)
    if photo is not None and tape.photo not in (None, photo):
        raise ModelError(f"tape {path} was recorded for another photo; record to another file")
    tape.photo = tape.photo or photo
    tape.made = made or tape.made
    return tape

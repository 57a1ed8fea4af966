"""Providers that call a model server through the SDK of its API.

The SDK retries transient failures. This module adds what the SDKs lack: no redirects, bounded
bodies, errors that name a remedy, and the schema in words where the server rejects it.
"""

import asyncio
import base64
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Sequence
from typing import Any, ClassVar

import anthropic
import httpx2

from ..config import MLLMOptions, RoleOptions
from ..errors import ModelError
from ..io.files import MIB
from ..io.names import plain_text
from .panel import environment_key
from .requests import MAX_BODY_BYTES, Picture, Rejection, Reply, Request, response_rule

RETRIES = 4
"""Maximum number of retries of a call after transient errors: rate limits, overload, lost
connections. The SDKs wait between 0.5 and 8 s before a retry, or as long as the server asks."""
CACHE_S = 4.0
"""Time by which the first of several requests with the same instructions precedes the others [s].
A server's prompt cache contains the instructions only when it begins to respond to a request that
contains them; until then, each request would be billed for writing them."""
CONNECT_S = 10.0
"""Maximum time to connect to a server [s]."""
_MAX_PICTURE_BYTES = 3_500_000
"""Maximum size of a picture that is sent as it is; servers reject pictures over 5 MB in base64."""


class ServerProvider(ABC):
    """A provider that calls a server's API.

    Args:
        options: base_url and maximum length of a response.

    Raises:
        ModelError: there is neither a key nor a base_url.
    """

    name: ClassVar[str]
    key_name: ClassVar[str]
    url_name: ClassVar[str]
    online = True

    def __init__(self, options: MLLMOptions) -> None:
        self.url = options.base_url or environment_key(self.url_name)
        """Address of the server. If None, the SDK's default address is used."""
        key = environment_key(self.key_name)
        if key is None and self.url is None:
            raise ModelError(
                f"no key: set {self.key_name}, or name a local server in mllm.base_url, "
                "or choose another provider"
            )
        self.key = key or "none"
        self.secrets: tuple[str, ...] = () if key is None else (key,)
        self.max_tokens = options.max_tokens
        self._client: Any = None
        self._rejected_schemas: set[tuple[str, str]] = set()
        """Model and digest of each schema that the server rejected."""
        self._cached: dict[tuple[str, str, str], asyncio.Event] = {}
        """For each model, instructions and schema, whether the server's cache contains them."""

    @abstractmethod
    def _new_client(self) -> Any:
        """Return a client of the SDK."""

    @abstractmethod
    def _params(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> dict[str, Any]:
        """Return the parameters of a call."""

    @abstractmethod
    async def _send(self, params: dict[str, Any]) -> Reply:
        """Make a call, and convert the SDK's response."""

    async def reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Make one call. If the server rejects its schema, put the schema into the prompt.

        Raises:
            ModelError: there is no response; the message states a remedy.
        """
        if self._client is None:
            self._client = self._new_client()
        prefix = (role.model, request.parts["system"], request.parts["schema"])
        cached = self._cached.get(prefix)
        if cached is not None:
            await cached.wait()
            return await self._reply(request, role, rejected)
        cached = self._cached[prefix] = asyncio.Event()
        timer = asyncio.get_running_loop().call_later(CACHE_S, cached.set)
        try:
            return await self._reply(request, role, rejected)
        finally:
            timer.cancel()
            cached.set()

    async def _reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        schema = (role.model, request.parts["schema"])
        while True:
            enforced = schema not in self._rejected_schemas
            # Encoding pictures may take seconds.
            params = await asyncio.to_thread(self._params, request, role, rejected)
            try:
                return await self._send(params)
            except Exception as error:
                if not enforced or getattr(error, "status_code", None) not in (400, 422):
                    reason = self._failure(error, request, role)
                    raise ModelError(f"{request.name}: {reason}") from None
            self._rejected_schemas.add(schema)

    async def close(self) -> None:
        """Close the connections."""
        client, self._client = self._client, None
        if client is not None:
            await client.close()

    def _schema(self, request: Request[Any], role: RoleOptions) -> dict[str, Any] | None:
        """Return the schema for the server to enforce; None if the server cannot enforce it."""
        if (role.model, request.parts["schema"]) in self._rejected_schemas:
            return None
        try:
            return anthropic.transform_schema(request.json_schema)
        except ValueError:
            return None  # Structured output cannot express the schema, such as a field of any type.

    def _prompt(self, request: Request[Any], schema: dict[str, Any] | None) -> str:
        # A local server may accept a schema without enforcing it.
        if schema is not None and self.url is None:
            return request.prompt
        return f"{request.prompt}\n\n{response_rule(request)}"

    def _failure(self, error: Exception, request: Request[Any], role: RoleOptions) -> str:
        """Describe an exception of a call. Both SDKs' errors have `status_code` and `request`."""
        for cause in (error, error.__cause__):
            if isinstance(cause, ModelError):  # Raised by a hook of the HTTP client.
                return str(cause)
        status = getattr(error, "status_code", None)
        if isinstance(status, int) and not (status in (408, 409, 429) or status >= 500):
            return self._rejection(error, status, request, role)
        if isinstance(status, int):
            reason = f"HTTP {status}: {_message(error)}"
        elif hasattr(error, "request"):
            cause = error.__cause__ or error
            reason = f"the connection failed ({type(cause).__name__}: {cause})"
        else:
            return (
                f"{self.url or 'the service'} does not respond as this provider's API does "
                f"({type(error).__name__}); check mllm.base_url and --provider"
            )
        return (
            f"{self.name} did not answer, with up to {RETRIES} retries: {reason}. "
            "Resume the run later"
        )

    def _rejection(self, error: Any, status: int, request: Request[Any], role: RoleOptions) -> str:
        server = self.url or "the service"
        reason = f"({status}: {_message(error)})"
        if status in (401, 403):
            return f"the key in {self.key_name} was refused {reason}; set a valid one"
        if status == 404:
            return (
                f"{server} does not know the model {role.model!r} or the address {reason}; check "
                f"mllm.{request.role}.model and mllm.base_url"
            )
        if 300 <= status < 400:
            target = plain_text(error.response.headers.get("location", "another address"), 300)
            return (
                f"{server} redirects to {target}, where neither the key nor the photograph is "
                "sent; if you trust that server, name it in mllm.base_url"
            )
        return f"{server} rejected the request for {role.model!r} {reason}"


def client_arguments(provider: ServerProvider, sdk: Any) -> dict[str, Any]:
    """Return the arguments with which a provider opens the client of its SDK."""
    return {
        "api_key": provider.key,
        "base_url": provider.url,
        "timeout": httpx2.Timeout(None, connect=CONNECT_S),  # `Panel` limits the whole call.
        "max_retries": RETRIES,
        "http_client": sdk.DefaultAsyncHttpxClient(
            follow_redirects=False,  # The SDKs would send keys to every address.
            headers={"accept-encoding": "identity"},
            event_hooks={"response": [_bound_body]},
        ),
    }


def encoded(picture: Picture) -> tuple[str, str]:
    """Return a picture's media type and base64 text; a file that is too large becomes a JPEG."""
    media_type, data = picture.bounded(_MAX_PICTURE_BYTES)
    return media_type, base64.b64encode(data).decode()


def corrections(request: Request[Any], rejected: Sequence[Rejection]) -> list[tuple[str, str]]:
    """Return the rejected responses and their errors as messages (role, text) after the prompt."""
    turns = []
    for rejection in rejected:
        turns.append(("assistant", rejection.text.strip() or "(nothing)"))
        turns.append(("user", rejection.message(request)))
    return turns


def _message(error: Exception) -> str:
    """Return a server's message about an error as one line of at most 300 characters."""
    body = getattr(error, "body", None)
    inner = body.get("error", body) if isinstance(body, dict) else None
    message = inner.get("message") if isinstance(inner, dict) else None
    return plain_text(str(message or getattr(error, "message", "") or error), 300)


async def _bound_body(response: httpx2.Response) -> None:
    if response.headers.get("content-encoding", "identity") != "identity":
        raise ModelError("the server compresses its response, although the request forbids it")
    response.stream = _BoundedBody(response.stream)


class _BoundedBody(httpx2.AsyncByteStream):
    """The body of a response. Reading more than `MAX_BODY_BYTES` raises ModelError."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    async def __aiter__(self) -> AsyncIterator[bytes]:
        size = 0
        async for chunk in self._stream:
            size += len(chunk)
            if size > MAX_BODY_BYTES:
                raise ModelError(f"the server's response has over {MAX_BODY_BYTES // MIB} MiB")
            yield chunk
            # Without this, no deadline can interrupt the reading of a body that has arrived.
            await asyncio.sleep(0)

    async def aclose(self) -> None:
        await self._stream.aclose()

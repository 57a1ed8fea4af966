"""Limits of the HTTP exchange with a model server: one origin, bounded bodies.

The SDKs follow redirects, send headers with keys to every address that a server names, and read
bodies of any size. `http_limits` returns hooks that prevent this. The hooks belong to the HTTP
clients of the SDKs and work with and without a proxy.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import Any

import httpx2

from ..errors import ModelError
from ..io.files import MIB
from ..io.names import plain_text

MAX_BODY_BYTES = 64 * MIB
"""Maximum size of a decompressed response; a stream has about 300 bytes per token."""
MAX_PACKED_BYTES = 16 * MIB
"""Maximum size of a compressed response, before decompression."""
MAX_LINES = 1_000_000
"""Maximum number of lines of a response; a stream has about three lines per token."""
MAX_LINE_BYTES = 4 * MIB
"""Maximum length of a line; an event of a stream is one line."""
MAX_ERROR_BYTES = MIB
"""Size at which the body of a redirect or an error is cut off, before and after decompression."""


def http_limits() -> dict[str, Any]:
    """Return the arguments of an HTTP client that enforces these limits.

    A request raises a ModelError if a redirect or a server's response leads to an origin other than
    that of the first request. Reading a response raises a ModelError if its body is too large.
    """
    first_origin: list[str] = []

    async def check_origin(request: httpx2.Request) -> None:
        target = _origin(request.url)
        first_origin[:] = first_origin or [target]
        if target != first_origin[0]:
            raise ModelError(
                f"the server {first_origin[0]} redirects to {target}, where neither the key nor "
                "the photograph is sent; if you trust that server, name it in mllm.base_url"
            )

    async def bound_body(response: httpx2.Response) -> None:
        response.stream = _BoundedBody(response)
        # The bounded body is already decompressed.
        response.headers.pop("content-encoding", None)

    return {"event_hooks": {"request": [check_origin], "response": [bound_body]}}


def _origin(url: httpx2.URL) -> str:
    port = url.port or {"http": 80, "https": 443}.get(url.scheme, 0)
    return plain_text(f"{url.scheme}://{url.host}:{port}", 300)


class _BoundedBody(httpx2.AsyncByteStream):
    """The decompressed body of a response; the body of an error is cut off at its limit."""

    def __init__(self, response: httpx2.Response) -> None:
        self._error = not response.is_success
        self._limit = MAX_ERROR_BYTES if self._error else MAX_BODY_BYTES
        packed = "content-encoding" in response.headers
        self._raw = _Counted(
            response.stream, min(self._limit, MAX_PACKED_BYTES) if packed else self._limit
        )
        self._packed = httpx2.Response(
            response.status_code, headers=response.headers, stream=self._raw,
            request=response.request,
        )  # fmt: skip

    async def __aiter__(self) -> AsyncIterator[bytes]:
        size = line = lines = 0
        async with aclosing(self._packed.aiter_bytes()) as chunks:
            async for chunk in chunks:
                size += len(chunk)
                lines += chunk.count(b"\n")
                if size > self._limit and self._error:
                    return
                if size > self._limit or lines > MAX_LINES:
                    raise _too_large(f"{self._limit // MIB} MiB, or {MAX_LINES} lines")
                end = chunk.rfind(b"\n")
                line = line + len(chunk) if end < 0 else len(chunk) - end - 1
                if line > MAX_LINE_BYTES:
                    raise _too_large(f"{MAX_LINE_BYTES // MIB} MiB in one line")
                yield chunk
                # Without this, no timeout can interrupt the reading of a body that has arrived.
                await asyncio.sleep(0)
        if self._raw.exceeded and not self._error:
            raise _too_large(f"{self._raw.limit // MIB} MiB as sent")

    async def aclose(self) -> None:
        await self._packed.aclose()


class _Counted(httpx2.AsyncByteStream):
    """A body before decompression, which ends at a limit."""

    def __init__(self, stream: Any, limit: int) -> None:
        self._stream, self.limit, self.exceeded = stream, limit, False

    async def __aiter__(self) -> AsyncIterator[bytes]:
        size = 0
        async for chunk in self._stream:
            size += len(chunk)
            if size > self.limit:
                self.exceeded = True
                return
            yield chunk

    async def aclose(self) -> None:
        await self._stream.aclose()


def _too_large(limit: str) -> ModelError:
    return ModelError(f"the server's response has over {limit}")

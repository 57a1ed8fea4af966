"""Connections to model servers: address, key and headers, encoding of pictures, and errors."""

import base64
import email.utils
import io
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import httpx2
from PIL import Image

from ..config import MLLMOptions, Role, RoleOptions
from ..errors import ModelError
from .requests import Picture, Transient, Usage
from .secrets import environment_key, expand

_MAX_PICTURE_BYTES = 3_500_000
"""Maximum size of a picture that is sent; servers reject pictures over 5 MB in base64."""


@dataclass(frozen=True)
class Connection:
    """Address, key and headers of a server, from the options and the environment."""

    url: str | None
    """Address of the server. If None, the SDK's default address is used."""
    key: str = field(repr=False)
    key_name: str
    headers: dict[str, str] = field(repr=False)
    secrets: tuple[str, ...] = field(repr=False)
    timeout_s: float

    @property
    def local(self) -> bool:
        """True if an address is given, so the server is not the service's default server."""
        return self.url is not None

    def merged_headers(self, defaults: Mapping[str, str]) -> dict[str, str]:
        """Return the default headers, overridden by the user's headers; names ignore case."""
        user_names = {name.lower() for name in self.headers}
        return {n: v for n, v in defaults.items() if n.lower() not in user_names} | self.headers


def configured_connection(options: MLLMOptions, key_name: str, url_name: str) -> Connection:
    """Read key, address and headers from the environment and the options.

    Raises:
        ConfigError: a header needs an environment variable that is not set.
        ModelError: there is neither a key nor a base_url.
    """
    url = options.base_url or environment_key(url_name)
    key = environment_key(key_name)
    if key is None and url is None:
        raise ModelError(
            f"no key: set {key_name}, or name a local server in mllm.base_url, "
            f"or choose another provider"
        )
    headers, header_secrets = expand(options.headers)
    secrets = tuple(text for text in (key, *header_secrets) if text)
    return Connection(url, key or "none", key_name, headers, secrets, options.timeout_s)


@lru_cache(maxsize=4)
def encoded(picture: Picture) -> tuple[str, str]:
    """Return a picture's media type and base64 text.

    A file that is too large is encoded again as JPEG. The last results are cached, because many
    requests contain the photograph.
    """
    data, media_type = picture.data, picture.media_type
    if len(data) > _MAX_PICTURE_BYTES:
        media_type = "image/jpeg"
        with Image.open(io.BytesIO(picture.data), formats=["PNG", "JPEG"]) as image:
            rgb = image.convert("RGB")
        for quality in (95, 85, 70):
            buffer = io.BytesIO()
            rgb.save(buffer, "JPEG", quality=quality)
            data = buffer.getvalue()
            if len(data) <= _MAX_PICTURE_BYTES:
                break
    return media_type, base64.b64encode(data).decode()


def classified(
    error: Exception, connection: Connection, role: Role, options: RoleOptions, usage: Usage
) -> Exception:
    """Convert an exception of a call to Transient if a retry may help, otherwise to ModelError.

    The errors of both SDKs have the attributes `status_code`, `response` and `message`.
    """
    for refused in (error, error.__cause__):
        if isinstance(refused, ModelError):  # Raised by `http_limits`.
            return refused
    status = getattr(error, "status_code", None)
    if isinstance(status, int):
        return _classified_status(error, status, connection, role, options, usage)
    if isinstance(error, TimeoutError | httpx2.TimeoutException) or (
        type(error).__name__ == "APITimeoutError"
    ):
        return Transient(f"no data from the server for {connection.timeout_s:g} s", usage=usage)
    if isinstance(error, httpx2.TransportError) or hasattr(error, "request"):
        cause = error.__cause__ or error
        name = type(cause).__name__
        reason = f"{name}: {cause}" if str(cause) else name
        return Transient(f"the connection failed ({reason})", usage=usage)
    if isinstance(error, json.JSONDecodeError | UnicodeDecodeError):
        return Transient(f"the server's response is garbled ({error})", usage=usage)
    if isinstance(error, TypeError | AttributeError | LookupError):
        server = connection.url or "the service"
        return ModelError(
            f"{server} does not respond as this provider's API does ({type(error).__name__}); "
            "check mllm.base_url and --provider"
        )
    return ModelError(f"{type(error).__name__}: {error}")


def _classified_status(
    error: Exception,
    status: int,
    connection: Connection,
    role: Role,
    options: RoleOptions,
    usage: Usage,
) -> Exception:
    message = server_message(error)
    server = connection.url or "the service"
    if status in (401, 403):
        return ModelError(
            f"the key in {connection.key_name} was refused ({status}: {message}); set a valid one"
        )
    if status == 402 or "insufficient_quota" in message or "credit balance" in message:
        return ModelError(f"the account has no credit ({status}: {message})")
    if status == 404:
        return ModelError(
            f"{server} does not know the model {options.model!r} or the address "
            f"({status}: {message}); check mllm.{role}.model and mllm.base_url"
        )
    # Status 200 is an error event within a stream that started successfully.
    if status in (200, 408, 409, 425, 429) or status >= 500:
        return Transient(f"HTTP {status}: {message}", _retry_after(error), usage)
    return ModelError(f"{server} rejected the request for {options.model!r} ({status}: {message})")


def server_message(error: Exception) -> str:
    """Return a server's message about an error as one line of at most 300 characters."""
    body = getattr(error, "body", None)
    inner = body.get("error", body) if isinstance(body, dict) else None
    message = inner.get("message") if isinstance(inner, dict) else None
    code = inner.get("code") if isinstance(inner, dict) else None
    text = str(message or getattr(error, "message", "") or error)
    text = f"{text} [{code}]" if isinstance(code, str) and code not in text else text
    text = " ".join(text.split())
    return text if len(text) <= 300 else text[:297] + "..."


def _retry_after(error: Exception) -> float | None:
    response = getattr(error, "response", None)
    headers = getattr(response, "headers", {})
    if getattr(response, "status_code", None) == 200:
        return None
    for name, unit in (("retry-after-ms", 1e-3), ("retry-after", 1.0)):
        text = headers.get(name)
        if text is None:
            continue
        try:
            wait = float(text) * unit
        except ValueError:
            date = email.utils.parsedate_tz(text)
            if date is None:
                continue
            wait = email.utils.mktime_tz(date) - time.time()
        if wait == wait:
            return max(wait, 0.0)
    return None

"""What the two servers' APIs share: where and how to connect, pictures as sent, errors explained."""

import asyncio
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
from .model import Picture, Transient, Usage
from .secrets import environment_key, expand

_MOST_BYTES = 3_500_000
"""Servers refuse pictures of over 5 MB in base64."""
_PATIENCE = 10
"""A call as a whole may take so many times the longest silence."""


@dataclass(frozen=True)
class Line:
    """A connection to a server, as far as the options and the environment determine it."""

    url: str | None
    """None: the service's own."""
    key: str = field(repr=False)
    key_name: str
    headers: dict[str, str] = field(repr=False)
    secrets: tuple[str, ...] = field(repr=False)
    timeout_s: float

    @property
    def local(self) -> bool:
        """Whether another server than the service's own is spoken to."""
        return self.url is not None

    @property
    def longest_s(self) -> float:
        """The longest a call may take as a whole, in seconds."""
        return _PATIENCE * self.timeout_s


def open_line(options: MLLMOptions, key_name: str, url_name: str) -> Line:
    """Take key, address and headers from the environment and the options.

    Raises:
        ConfigError: a header needs an environment variable that is not set.
        ModelError: there is no key, and no base_url that may do without.
    """
    url = options.base_url or environment_key(url_name)
    key = environment_key(key_name)
    if key is None and url is None:
        raise ModelError(
            f"no key: set {key_name}, or name a local server in mllm.base_url, "
            f"or choose another provider"
        )
    headers, filled = expand(options.headers)
    secrets = tuple(text for text in (key, *filled) if text)
    return Line(url, key or "none", key_name, headers, secrets, options.timeout_s)


def with_headers(line: Line, defaults: Mapping[str, str]) -> dict[str, str]:
    """Lay the user's headers over defaults, whatever their case."""
    given = {name.lower() for name in line.headers}
    return {n: v for n, v in defaults.items() if n.lower() not in given} | line.headers


@lru_cache(maxsize=4)
def as_sent(picture: Picture) -> tuple[str, str]:
    """Return a picture's media type and base64 text; one that is too big goes as JPEG.

    A few are kept, as a photograph is sent with many requests.
    """
    data, kind = picture.data, picture.media_type
    if len(data) > _MOST_BYTES:
        kind = "image/jpeg"
        with Image.open(io.BytesIO(picture.data)) as image:
            rgb = image.convert("RGB")
        for quality in (95, 85, 70):
            buffer = io.BytesIO()
            rgb.save(buffer, "JPEG", quality=quality)
            data = buffer.getvalue()
            if len(data) <= _MOST_BYTES:
                break
    return kind, base64.b64encode(data).decode()


def explain(
    error: Exception, line: Line, role: Role, options: RoleOptions, usage: Usage
) -> Exception:
    """Turn what a call raised into Transient where another try may help, else one ModelError.

    The SDKs' errors share their shape: `status_code`, `response` and `message`.
    """
    status = getattr(error, "status_code", None)
    if isinstance(status, int):
        return _explain_status(error, status, line, role, options, usage)
    if _is_timeout(error):
        return Transient(f"no sign from the server for {line.timeout_s:g} s", usage=usage)
    if isinstance(error, httpx2.TransportError) or hasattr(error, "request"):
        cause = error.__cause__ or error
        return Transient(f"the connection failed ({_words(cause)})", usage=usage)
    if isinstance(error, json.JSONDecodeError | UnicodeDecodeError):
        return Transient(f"the server's answer is garbled ({error})", usage=usage)
    return ModelError(f"{type(error).__name__}: {error}")


def _is_timeout(error: Exception) -> bool:
    kinds = (TimeoutError, asyncio.TimeoutError, httpx2.TimeoutException)
    return isinstance(error, kinds) or type(error).__name__ == "APITimeoutError"


def _explain_status(
    error: Exception, status: int, line: Line, role: Role, options: RoleOptions, usage: Usage
) -> Exception:
    said = message_of(error)
    where = line.url or "the service"
    if status in (401, 403):
        return ModelError(
            f"the key in {line.key_name} was refused ({status}: {said}); set a valid one"
        )
    if status == 402 or "insufficient_quota" in said or "credit balance" in said:
        return ModelError(f"the account has no credit ({status}: {said})")
    if status == 404:
        return ModelError(
            f"{where} does not know the model {options.model!r} or the address ({status}: {said}); "
            f"check mllm.{role}.model and mllm.base_url"
        )
    # 200 is an error event inside a stream that had begun well.
    if status in (200, 408, 409, 425, 429) or status >= 500:
        return Transient(f"HTTP {status}: {said}", _retry_after(error), usage)
    return ModelError(f"{where} rejected the request for {options.model!r} ({status}: {said})")


def message_of(error: Exception) -> str:
    """Return what a server said about an error, in one short line."""
    body = getattr(error, "body", None)
    inner = body.get("error", body) if isinstance(body, dict) else None
    said = inner.get("message") if isinstance(inner, dict) else None
    code = inner.get("code") if isinstance(inner, dict) else None
    text = str(said or getattr(error, "message", "") or error)
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


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__

"""Provider for servers with the chat completions API: OpenAI's server, and compatible servers."""

import importlib
from collections.abc import Sequence
from typing import Any

from ..config import MLLMOptions, RoleOptions
from ..errors import ModelError
from .connection import encoded, server_message
from .http_limits import http_limits
from .requests import Rejection, Reply, Request, Usage
from .server import Received, ServerProvider, corrections

_TOKEN_LIMITS = ("max_tokens", "max_completion_tokens")
_STOPS: dict[str, Any] = {"length": "length", "content_filter": "refusal"}


class OpenAI(ServerProvider):
    """Provider for the chat completions API.

    Args:
        options: models, base_url, headers and time limit.

    Raises:
        ConfigError: a header needs an environment variable that is not set.
        ModelError: the extra `openai` is not installed, or there is neither a key nor a base_url.
    """

    name = "openai"
    key_name = "OPENAI_API_KEY"
    url_name = "OPENAI_BASE_URL"
    schema_feature = "response_format"
    features = {
        "stream_options": ("stream_options",),
        "response_format": ("response_format", "json_schema", "schema", "structured", "grammar"),
    }

    def __init__(self, options: MLLMOptions) -> None:
        try:
            self._sdk: Any = importlib.import_module("openai")
        except ModuleNotFoundError:
            raise ModelError(
                "provider openai needs its extra: uv sync --inexact --extra openai"
            ) from None
        super().__init__(options)

    async def reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Make one call; if the server rejects a feature, repeat the call without the feature.

        Raises:
            Transient: a retry may help.
            ModelError: a retry cannot help, for example if the model belongs to another service.
        """
        if role.model.startswith("claude") and not self._connection.local:
            raise ModelError(
                f"mllm.{request.role}.model is {role.model!r}, which this service does not have; "
                f"name one of its models in the config"
            )
        return await super().reply(request, role, rejected)

    async def _receive(self, params: dict[str, Any], received: Received) -> None:
        stream = await self._open().chat.completions.create(**params)
        async for chunk in stream:
            received.model = chunk.model or received.model
            if chunk.usage is not None:
                received.usage = _usage(chunk.usage)
            for choice in chunk.choices[:1]:
                received.text += choice.delta.content or ""
                received.refusal += getattr(choice.delta, "refusal", None) or ""
                if choice.finish_reason:
                    received.stop = _STOPS.get(choice.finish_reason, "end")
        if received.stop is not None and received.refusal:
            received.stop = "refusal"

    def _new_client(self) -> Any:
        return self._sdk.AsyncOpenAI(
            api_key=self._connection.key,
            base_url=self._connection.url,
            default_headers=self._connection.merged_headers({}),
            timeout=self._connection.timeout_s,
            max_retries=0,
            http_client=self._sdk.DefaultAsyncHttpxClient(**http_limits()),
        )

    def _params(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> dict[str, Any]:
        schema = self._schema(request, role)
        messages: list[dict[str, Any]] = []
        if request.system:
            messages.append({"role": "system", "content": request.system})
        prompt = {"type": "text", "text": self._prompt(request, schema)}
        messages.append({"role": "user", "content": [*_pictures(request), prompt]})
        for speaker, text in corrections(request, rejected):
            messages.append({"role": speaker, "content": text})
        # Most compatible servers know only the older name of the limit and ignore the newer name.
        names = _TOKEN_LIMITS if self._connection.local else _TOKEN_LIMITS[::-1]
        limit = names[0] if self._supports(names[0], request, role) else names[1]
        params: dict[str, Any] = {
            "model": role.model,
            "messages": messages,
            "stream": True,
            limit: role.max_tokens,
        }
        if self._supports("stream_options", request, role):
            params["stream_options"] = {"include_usage": True}
        if schema is not None:
            body = {
                "name": request.json_schema["title"],
                "schema": _strict(schema),
                "strict": True,
            }
            params["response_format"] = {"type": "json_schema", "json_schema": body}
        return params

    def _rejected_feature(self, error: Exception, params: dict[str, Any]) -> str | None:
        feature = super()._rejected_feature(error, params)
        if feature is not None or getattr(error, "status_code", None) not in (400, 422):
            return feature
        message = server_message(error).lower()
        limit = next(name for name in _TOKEN_LIMITS if name in params)
        unsupported = any(
            word in message for word in ("unsupported", "not supported", "unrecognized")
        )
        return limit if unsupported and limit in message else None


def _strict(schema: Any) -> Any:
    """Return a schema in which every property is required, as strict mode demands."""
    if isinstance(schema, list):
        return [_strict(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    strict = {key: _strict(value) for key, value in schema.items()}
    if schema.get("type") == "object" and isinstance(schema.get("properties"), dict):
        strict["required"] = list(schema["properties"])
    return strict


def _pictures(request: Request[Any]) -> list[dict[str, Any]]:
    blocks: list[dict[str, Any]] = []
    for picture in request.pictures:
        media_type, data = encoded(picture)
        blocks.append({"type": "text", "text": f"{picture.label}:"})
        url = f"data:{media_type};base64,{data}"
        blocks.append({"type": "image_url", "image_url": {"url": url}})
    return blocks


def _usage(counts: Any) -> Usage:
    """Read token counts; the server's prompt tokens include cached tokens, which `input` omits."""
    details = getattr(counts, "prompt_tokens_details", None)
    read = int(getattr(details, "cached_tokens", None) or 0)
    write = int(getattr(details, "cache_write_tokens", None) or 0)
    prompt = int(counts.prompt_tokens or 0)
    return Usage(max(prompt - read - write, 0), int(counts.completion_tokens or 0), read, write)

"""Provider for servers with the Messages API: Anthropic's server, and local servers such as vLLM.

Many requests share the system text and the first picture, so both are marked for the prompt cache.
"""

import asyncio
from collections.abc import Sequence
from typing import Any, cast

import anthropic

from ..config import MLLMOptions, RoleOptions
from ..errors import ModelError
from .connection import classified, encoded
from .http_limits import http_limits
from .requests import Rejection, Reply, Request, Usage
from .server import Received, ServerProvider, corrections

_CACHE = {"type": "ephemeral"}


class Anthropic(ServerProvider):
    """Provider for the Messages API.

    Args:
        options: models, base_url, headers and time limit.
        batch_poll_s: interval at which a batch is polled [s].

    Raises:
        ConfigError: a header needs an environment variable that is not set.
        ModelError: there is neither a key nor a base_url.
    """

    name = "anthropic"
    key_name = "ANTHROPIC_API_KEY"
    url_name = "ANTHROPIC_BASE_URL"
    schema_feature = "output_config"
    features = {"output_config": ("output_config", "output_format", "schema", "structured")}

    def __init__(self, options: MLLMOptions, *, batch_poll_s: float = 30.0) -> None:
        super().__init__(options)
        self._retries, self._call_timeout_s = options.retries, options.call_timeout_s
        self._batch_poll_s = batch_poll_s

    async def _receive(self, params: dict[str, Any], received: Received) -> None:
        stream = await self._open().messages.create(**params, stream=True)
        async for event in stream:
            if event.type == "message_start":
                received.model = event.message.model or received.model
                received.usage = _usage(event.message.usage, Usage())
            elif event.type == "content_block_delta" and event.delta.type == "text_delta":
                received.text += event.delta.text
            elif event.type == "message_delta":
                if event.delta.stop_reason is not None:
                    received.stop = _stop(event.delta.stop_reason)
                received.refusal = _refusal(event.delta)
                received.usage = _usage(event.usage, received.usage or Usage())

    async def batch(self, calls: Sequence[tuple[Request[Any], RoleOptions]]) -> list[Reply | None]:
        """Send requests as one message batch and wait until the batch has ended.

        Returns:
            The reply to each request; None for a request to which the batch gave no reply.

        Raises:
            ModelError: the batch could not be sent or fetched.
        """
        request, role = calls[0]
        limit_s = self._call_timeout_s
        batches = self._open().with_options(max_retries=self._retries).messages.batches
        sent = [{"custom_id": r.key, "params": self._params(r, o, ())} for r, o in calls]
        replies: dict[str, Reply] = {}
        try:
            async with asyncio.timeout(limit_s):
                batch = await batches.create(requests=cast(Any, sent))
            while batch.processing_status != "ended":
                await asyncio.sleep(self._batch_poll_s)
                async with asyncio.timeout(limit_s):
                    batch = await batches.retrieve(batch.id)
            async with asyncio.timeout(limit_s):
                async for item in await batches.results(batch.id):
                    if item.result.type == "succeeded":
                        replies[item.custom_id] = _batched_reply(item.result.message)
        except Exception as error:
            failure = classified(error, self._connection, request.role, role, Usage())
            raise ModelError(f"batch of {len(calls)} requests: {failure}") from None
        return [replies.get(r.key) for r, _ in calls]

    def _new_client(self) -> anthropic.AsyncAnthropic:
        connection = self._connection
        # The SDK sends the key as a bearer token; local servers may expect the older header.
        older = {"x-api-key": connection.key, "anthropic-version": "2023-06-01"}
        return anthropic.AsyncAnthropic(
            api_key=connection.key,
            base_url=connection.url,
            default_headers=connection.merged_headers(older if connection.local else {}),
            timeout=connection.timeout_s,
            max_retries=0,
            http_client=anthropic.DefaultAsyncHttpxClient(**http_limits()),
        )

    def _params(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> dict[str, Any]:
        schema = self._schema(request, role)
        first = [*_pictures(request), _text(self._prompt(request, schema))]
        messages: list[dict[str, Any]] = [{"role": "user", "content": first}]
        for speaker, text in corrections(request, rejected):
            messages.append({"role": speaker, "content": [_text(text)]})
        params: dict[str, Any] = {
            "model": role.model,
            "max_tokens": role.max_tokens,
            "messages": messages,
        }
        if request.system:
            params["system"] = [_text(request.system) | {"cache_control": _CACHE}]
        if schema is not None:
            params["output_config"] = {"format": {"type": "json_schema", "schema": schema}}
        return params


def _pictures(request: Request[Any]) -> list[dict[str, Any]]:
    blocks: list[dict[str, Any]] = []
    for number, picture in enumerate(request.pictures):
        media_type, data = encoded(picture)
        source = {"type": "base64", "media_type": media_type, "data": data}
        cache = {"cache_control": _CACHE} if number == 0 else {}
        blocks.append(_text(f"{picture.label}:"))
        blocks.append({"type": "image", "source": source} | cache)
    return blocks


def _text(text: str) -> dict[str, Any]:
    return {"type": "text", "text": text}


def _usage(counts: Any, before: Usage) -> Usage:
    """Read token counts; in a stream they are totals so far, and omitted ones stay as before."""

    def count(name: str, old: int) -> int:
        value = getattr(counts, name, None)
        return old if value is None else int(value)

    return Usage(
        count("input_tokens", before.input),
        count("output_tokens", before.output),
        count("cache_read_input_tokens", before.cache_read),
        count("cache_creation_input_tokens", before.cache_write),
    )


def _batched_reply(message: Any) -> Reply:
    text = "".join(block.text for block in message.content if block.type == "text")
    usage = _usage(message.usage, Usage())
    return Reply(text, usage, message.model, _stop(message.stop_reason), _refusal(message))


def _stop(reason: str | None) -> Any:
    if reason == "refusal":
        return "refusal"
    return "length" if reason in ("max_tokens", "model_context_window_exceeded") else "end"


def _refusal(message: Any) -> str:
    details = getattr(message, "stop_details", None)
    return str(getattr(details, "explanation", None) or "")

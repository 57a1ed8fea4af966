"""Servers that speak the Messages API: Anthropic's own, and local ones such as vLLM and Ollama.

Answers are streamed, so that the time limit watches for silence and not for length. What repeats
from request to request, the system text and the first picture, is marked for the prompt cache.
"""

import asyncio
from collections.abc import Sequence
from typing import Any, cast

import anthropic

from ..config import MLLMOptions, RoleOptions
from ..errors import ModelError
from .model import Rejection, Reply, Request, Transient, Usage, answer_rule
from .wire import Line, as_sent, explain, message_of, open_line, with_headers

_CACHE = {"type": "ephemeral"}
_PLAIN = "structured output is not supported by the server or for this schema: asked in words"


class Anthropic:
    """The provider for the Messages API.

    Args:
        options: models, base_url, headers and time limit.
        batch_poll_s: how often a batch is looked at, in seconds.

    Raises:
        ConfigError: a header needs an environment variable that is not set.
        ModelError: there is no key, and no base_url that may do without.
    """

    name = "anthropic"
    online = True

    def __init__(self, options: MLLMOptions, *, batch_poll_s: float = 30.0) -> None:
        self._line: Line = open_line(options, "ANTHROPIC_API_KEY", "ANTHROPIC_BASE_URL")
        self.secrets = self._line.secrets
        self._retries = options.retries
        self._batch_poll_s = batch_poll_s
        self._client: anthropic.AsyncAnthropic | None = None
        self._plain: set[tuple[str, str]] = set()
        """Models and schemas for which structured output was turned down."""

    async def reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Make one call.

        Raises:
            Transient: another try may help.
            ModelError: it will not; the message says what to do.
        """
        params = self._params(request, role, rejected)
        try:
            return await self._stream(request, role, params)
        except _Unstructured:
            self._plain.add((role.model, request.parts["schema"]))
            return await self._stream(request, role, self._params(request, role, rejected))

    async def _stream(
        self, request: Request[Any], role: RoleOptions, params: dict[str, Any]
    ) -> Reply:
        usage, text, stop, model, detail = Usage(), "", None, role.model, ""
        try:
            async with asyncio.timeout(self._line.longest_s):
                stream = await self._open().messages.create(**params, stream=True)
                async for event in stream:
                    if event.type == "message_start":
                        model = event.message.model or role.model
                        usage = _usage(event.message.usage, usage)
                    elif event.type == "content_block_delta" and event.delta.type == "text_delta":
                        text += event.delta.text
                    elif event.type == "message_delta":
                        stop = event.delta.stop_reason
                        detail = _refusal(event.delta)
                        usage = _usage(event.usage, usage)
        except anthropic.BadRequestError as error:
            if "output_config" in params and _turns_down_schema(error):
                raise _Unstructured from None
            raise explain(error, self._line, request.role, role, usage) from None
        except Exception as error:
            raise explain(error, self._line, request.role, role, usage) from None
        if stop is None:
            raise Transient("the answer broke off before its end", usage=usage)
        fallback = None if "output_config" in params else _PLAIN
        return Reply(text, usage, model, _stop(stop), detail, fallback)

    async def batch(self, asked: Sequence[tuple[Request[Any], RoleOptions]]) -> list[Reply | None]:
        """Send requests as one message batch and wait for its end.

        Returns:
            A reply for each request; None where the batch gave none.

        Raises:
            ModelError: the batch could not be sent or fetched.
        """
        request, role = asked[0]
        batches = self._open().with_options(max_retries=self._retries).messages.batches
        sent = [{"custom_id": r.key, "params": self._params(r, o, ())} for r, o in asked]
        replies: dict[str, Reply] = {}
        try:
            batch = await batches.create(requests=cast(Any, sent))
            while batch.processing_status != "ended":
                await asyncio.sleep(self._batch_poll_s)
                batch = await batches.retrieve(batch.id)
            async for item in await batches.results(batch.id):
                if item.result.type == "succeeded":
                    replies[item.custom_id] = _whole(item.result.message)
        except Exception as error:
            failure = explain(error, self._line, request.role, role, Usage())
            raise ModelError(f"batch of {len(asked)} requests: {failure}") from None
        return [replies.get(r.key) for r, _ in asked]

    async def close(self) -> None:
        """Close the connections."""
        client, self._client = self._client, None
        if client is not None:
            await client.close()

    def _open(self) -> anthropic.AsyncAnthropic:
        if self._client is None:
            line = self._line
            # The SDK sends the key as a bearer token; local servers may look for the older header.
            older = {"x-api-key": line.key, "anthropic-version": "2023-06-01"}
            self._client = anthropic.AsyncAnthropic(
                api_key=line.key,
                base_url=line.url,
                default_headers=with_headers(line, older if line.local else {}),
                timeout=line.timeout_s,
                max_retries=0,  # the panel retries, so that every call is booked
            )
        return self._client

    def _params(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> dict[str, Any]:
        plain = (role.model, request.parts["schema"]) in self._plain
        schema = None if plain else _schema(request)
        prompt = request.prompt
        if schema is None or self._line.local:
            # A local server may take output_config and not heed it.
            prompt = f"{prompt}\n\n{answer_rule(request)}"
        messages = [{"role": "user", "content": [*_pictures(request), _text(prompt)]}]
        for rejection in rejected:
            said = rejection.text.strip() or "(nothing)"
            messages.append({"role": "assistant", "content": [_text(said)]})
            messages.append({"role": "user", "content": [_text(rejection.message(request))]})
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


class _Unstructured(Exception):
    """The server turned structured output down."""


def _schema(request: Request[Any]) -> dict[str, Any] | None:
    try:
        return anthropic.transform_schema(request.json_schema)
    except ValueError:
        return None  # such as a field of any type, which structured output cannot express


def _pictures(request: Request[Any]) -> list[dict[str, Any]]:
    blocks: list[dict[str, Any]] = []
    for number, picture in enumerate(request.pictures):
        kind, data = as_sent(picture)
        source = {"type": "base64", "media_type": kind, "data": data}
        cache = {"cache_control": _CACHE} if number == 0 else {}
        blocks.append(_text(f"{picture.label}:"))
        blocks.append({"type": "image", "source": source} | cache)
    return blocks


def _text(text: str) -> dict[str, Any]:
    return {"type": "text", "text": text}


def _usage(given: Any, before: Usage) -> Usage:
    """Read token counts; counts in a stream are running totals, and a delta may leave some out."""

    def count(name: str, old: int) -> int:
        value = getattr(given, name, None)
        return old if value is None else int(value)

    return Usage(
        count("input_tokens", before.input),
        count("output_tokens", before.output),
        count("cache_read_input_tokens", before.cache_read),
        count("cache_creation_input_tokens", before.cache_write),
    )


def _whole(message: Any) -> Reply:
    text = "".join(block.text for block in message.content if block.type == "text")
    usage = _usage(message.usage, Usage())
    return Reply(text, usage, message.model, _stop(message.stop_reason), _refusal(message))


def _stop(reason: str | None) -> Any:
    if reason == "refusal":
        return "refusal"
    return "length" if reason in ("max_tokens", "model_context_window_exceeded") else "end"


def _refusal(given: Any) -> str:
    details = getattr(given, "stop_details", None)
    return str(getattr(details, "explanation", None) or "")


def _turns_down_schema(error: Exception) -> bool:
    said = message_of(error).lower()
    return any(word in said for word in ("output_config", "output_format", "schema", "structured"))

"""Provider for servers with the Messages API: Anthropic's server, and local servers such as vLLM.

Many requests share the system text and the first picture, so both are marked for the prompt cache.
"""

import os
from collections.abc import Sequence
from typing import Any

import anthropic

from ..config import MLLMOptions, RoleOptions
from .requests import Rejection, Reply, Request, Usage
from .server import ServerProvider, client_arguments, corrections, encoded

_CACHE = {"type": "ephemeral"}
_STOPS: dict[str | None, Any] = {
    "refusal": "refusal",
    "max_tokens": "length",
    "model_context_window_exceeded": "length",
}


class Anthropic(ServerProvider):
    """Provider for the Messages API.

    The SDK sends the headers in the environment variable ANTHROPIC_CUSTOM_HEADERS, which has lines
    of the form `name: value`.

    Args:
        options: base_url and maximum length of a response.

    Raises:
        ModelError: there is neither a key nor a base_url.
    """

    name = "anthropic"
    key_name = "ANTHROPIC_API_KEY"
    url_name = "ANTHROPIC_BASE_URL"

    def __init__(self, options: MLLMOptions) -> None:
        super().__init__(options)
        lines = os.environ.get("ANTHROPIC_CUSTOM_HEADERS", "").splitlines()
        self.secrets += tuple(line.partition(":")[2].strip() for line in lines)

    def _new_client(self) -> anthropic.AsyncAnthropic:
        # The SDK sends the key as a bearer token; local servers may expect the older header.
        older = {"x-api-key": self.key, "anthropic-version": "2023-06-01"}
        headers = older if self.url is not None else {}
        return anthropic.AsyncAnthropic(
            default_headers=headers, **client_arguments(self, anthropic)
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
            "max_tokens": self.max_tokens,
            "messages": messages,
        }
        if request.system:
            params["system"] = [_text(request.system) | {"cache_control": _CACHE}]
        if schema is not None:
            params["output_config"] = {"format": {"type": "json_schema", "schema": schema}}
        return params

    async def _send(self, params: dict[str, Any]) -> Reply:
        message = await self._client.messages.create(**params)
        text = "".join(block.text for block in message.content if block.type == "text")
        details = getattr(message, "stop_details", None)
        refusal = str(getattr(details, "explanation", None) or "")
        stop = _STOPS.get(message.stop_reason, "end")
        return Reply(text, _usage(message.usage), message.model or params["model"], stop, refusal)


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


def _usage(counts: Any) -> Usage | None:
    if counts is None:
        return None
    return Usage(
        counts.input_tokens or 0,
        counts.output_tokens or 0,
        getattr(counts, "cache_read_input_tokens", None) or 0,
        getattr(counts, "cache_creation_input_tokens", None) or 0,
    )

"""Provider for servers with the chat completions API: OpenAI's server, and compatible servers."""

import importlib
from collections.abc import Sequence
from typing import Any

from ..config import MLLMOptions, RoleOptions
from ..errors import ModelError
from .requests import Rejection, Reply, Request, Usage
from .server import ServerProvider, client_arguments, corrections, encoded

_STOPS: dict[str | None, Any] = {"length": "length", "content_filter": "refusal"}


class OpenAI(ServerProvider):
    """Provider for the chat completions API.

    Args:
        options: base_url and maximum length of a response.

    Raises:
        ModelError: the extra `openai` is not installed, or there is neither a key nor a base_url.
    """

    name = "openai"
    key_name = "OPENAI_API_KEY"
    url_name = "OPENAI_BASE_URL"

    def __init__(self, options: MLLMOptions) -> None:
        try:
            self._sdk: Any = importlib.import_module("openai")
        except ModuleNotFoundError:
            raise ModelError(
                "provider openai needs its extra: uv sync --inexact --extra openai"
            ) from None
        super().__init__(options)

    def _new_client(self) -> Any:
        return self._sdk.AsyncOpenAI(**client_arguments(self, self._sdk))

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
        limit = "max_completion_tokens" if self.url is None else "max_tokens"
        params: dict[str, Any] = {
            "model": role.model,
            "messages": messages,
            limit: self.max_tokens,
        }
        if schema is not None:
            body = {
                "name": request.json_schema["title"],
                "schema": _strict(schema),
                "strict": True,
            }
            params["response_format"] = {"type": "json_schema", "json_schema": body}
        return params

    async def _send(self, params: dict[str, Any]) -> Reply:
        completion = await self._client.chat.completions.create(**params)
        choice = completion.choices[0]
        refusal = getattr(choice.message, "refusal", None) or ""
        stop = "refusal" if refusal else _STOPS.get(choice.finish_reason, "end")
        model = completion.model or params["model"]
        return Reply(choice.message.content or "", _usage(completion.usage), model, stop, refusal)


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


def _usage(counts: Any) -> Usage | None:
    """Read token counts; the server's prompt tokens include cached tokens, which `input` omits."""
    if counts is None:
        return None
    details = getattr(counts, "prompt_tokens_details", None)
    read = int(getattr(details, "cached_tokens", None) or 0)
    write = int(getattr(details, "cache_write_tokens", None) or 0)
    prompt = int(counts.prompt_tokens or 0)
    return Usage(max(prompt - read - write, 0), int(counts.completion_tokens or 0), read, write)

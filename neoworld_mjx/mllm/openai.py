"""Servers that speak the chat completions API: OpenAI's own, and every compatible one.

What a server turns down (a JSON schema for the answer, token counts in the stream, one of the two
names of the token limit) is left out from then on, and the ledger says so.
"""

import asyncio
import importlib
from collections.abc import Sequence
from typing import Any

import anthropic

from ..config import MLLMOptions, RoleOptions
from ..errors import ModelError
from .model import Rejection, Reply, Request, Transient, Usage, answer_rule
from .wire import Line, as_sent, explain, message_of, open_line, with_headers

_PLAIN = "structured output is not supported by the server or for this schema: asked in words"
_UNCOUNTED = "the server gave no token counts: booked at their upper bound"


class OpenAI:
    """The provider for the chat completions API.

    Args:
        options: models, base_url, headers and time limit.

    Raises:
        ConfigError: a header needs an environment variable that is not set.
        ModelError: the extra `openai` is not installed, there is no key and no base_url that may
            do without, or a role still names a model of another maker.
    """

    name = "openai"
    online = True

    def __init__(self, options: MLLMOptions) -> None:
        try:
            self._sdk: Any = importlib.import_module("openai")
        except ModuleNotFoundError:
            raise ModelError(
                "provider openai needs its extra: pip install 'neoworld-mjx[openai]'"
            ) from None
        self._line: Line = open_line(options, "OPENAI_API_KEY", "OPENAI_BASE_URL")
        self.secrets = self._line.secrets
        self._client: Any = None
        self._without: set[tuple[str, str, str]] = set()
        """What a model's server has turned down, as (model, feature, for which schema)."""

    async def reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Make one call.

        Raises:
            Transient: another try may help.
            ModelError: it will not; the message says what to do.
        """
        if role.model.startswith("claude") and not self._line.local:
            raise ModelError(
                f"mllm.{request.role}.model is {role.model!r}, which this service does not have; "
                f"name one of its models in the config"
            )
        while True:
            params = self._params(request, role, rejected)
            try:
                return await self._stream(request, role, params)
            except _TurnedDown as refused:
                self._without.add((role.model, refused.feature, _scope(refused.feature, request)))

    async def _stream(
        self, request: Request[Any], role: RoleOptions, params: dict[str, Any]
    ) -> Reply:
        text, refusal, stop, model = "", "", None, role.model
        usage: Usage | None = None
        try:
            async with asyncio.timeout(self._line.longest_s):
                stream = await self._open().chat.completions.create(**params)
                async for chunk in stream:
                    model = chunk.model or model
                    if chunk.usage is not None:
                        usage = _usage(chunk.usage)
                    for choice in chunk.choices[:1]:
                        text += choice.delta.content or ""
                        refusal += getattr(choice.delta, "refusal", None) or ""
                        stop = choice.finish_reason or stop
        except (self._sdk.BadRequestError, self._sdk.UnprocessableEntityError) as error:
            feature = _turned_down(error, params)
            if feature is not None:
                raise _TurnedDown(feature) from None
            raise explain(error, self._line, request.role, role, Usage()) from None
        except Exception as error:
            raise explain(error, self._line, request.role, role, usage or Usage()) from None
        if stop is None:
            raise Transient("the answer broke off before its end", usage=usage)
        notes = [] if "response_format" in params else [_PLAIN]
        if usage is None:
            notes.append(_UNCOUNTED)
        return Reply(
            text,
            usage or Usage(),
            model,
            "refusal" if refusal or stop == "content_filter" else _STOPS.get(stop, "end"),
            refusal,
            "; ".join(notes) or None,
            counted=usage is not None,
        )

    async def close(self) -> None:
        """Close the connections."""
        client, self._client = self._client, None
        if client is not None:
            await client.close()

    def _open(self) -> Any:
        if self._client is None:
            line = self._line
            self._client = self._sdk.AsyncOpenAI(
                api_key=line.key,
                base_url=line.url,
                default_headers=with_headers(line, {}),
                timeout=line.timeout_s,
                max_retries=0,  # the panel retries, so that every call is booked
            )
        return self._client

    def _params(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> dict[str, Any]:
        lacking = {
            feature
            for model, feature, scope in self._without
            if model == role.model and scope == _scope(feature, request)
        }
        schema = None if "response_format" in lacking else _schema(request)
        prompt = request.prompt
        if schema is None or self._line.local:
            # A local server may take response_format and not heed it.
            prompt = f"{prompt}\n\n{answer_rule(request)}"
        messages: list[dict[str, Any]] = []
        if request.system:
            messages.append({"role": "system", "content": request.system})
        content = [*_pictures(request), {"type": "text", "text": prompt}]
        messages.append({"role": "user", "content": content})
        for rejection in rejected:
            messages.append({"role": "assistant", "content": rejection.text or "(nothing)"})
            messages.append({"role": "user", "content": rejection.message(request)})
        # Compatible servers mostly know the older name alone, and ignore the newer one.
        older = self._line.local != ("max_tokens" in lacking or "max_completion_tokens" in lacking)
        params: dict[str, Any] = {
            "model": role.model,
            "messages": messages,
            "stream": True,
            "max_tokens" if older else "max_completion_tokens": role.max_tokens,
        }
        if "stream_options" not in lacking:
            params["stream_options"] = {"include_usage": True}
        if schema is not None:
            name = request.schema.__name__
            body = {"name": name, "schema": schema, "strict": True}
            params["response_format"] = {"type": "json_schema", "json_schema": body}
        return params


_STOPS: dict[str, Any] = {"length": "length", "content_filter": "refusal"}


class _TurnedDown(Exception):
    """The server does not take one of the features."""

    def __init__(self, feature: str) -> None:
        super().__init__(feature)
        self.feature = feature


def _scope(feature: str, request: Request[Any]) -> str:
    """A server may turn down one schema and take another."""
    return request.parts["schema"] if feature == "response_format" else ""


def _turned_down(error: Exception, params: dict[str, Any]) -> str | None:
    """Tell which optional feature of a call a server's rejection speaks of."""
    said = message_of(error).lower()
    limit = "max_tokens" if "max_tokens" in params else "max_completion_tokens"
    words = {
        "stream_options": ("stream_options",),
        "response_format": ("response_format", "json_schema", "schema", "structured", "grammar"),
    }
    for feature, signs in words.items():
        if feature in params and any(sign in said for sign in signs):
            return feature
    unsupported = any(word in said for word in ("unsupported", "not supported", "unrecognized"))
    return limit if unsupported and limit in said else None


def _schema(request: Request[Any]) -> dict[str, Any] | None:
    """Return the schema as strict mode wants it: nothing optional, nothing besides."""
    try:
        return _strict(anthropic.transform_schema(request.json_schema))
    except ValueError:
        return None  # such as a field of any type, which structured output cannot express


def _strict(schema: Any) -> Any:
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
        kind, data = as_sent(picture)
        blocks.append({"type": "text", "text": f"{picture.label}:"})
        url = f"data:{kind};base64,{data}"
        blocks.append({"type": "image_url", "image_url": {"url": url}})
    return blocks


def _usage(given: Any) -> Usage:
    """Read token counts; the server's prompt tokens include those of its cache."""
    details = getattr(given, "prompt_tokens_details", None)
    read = int(getattr(details, "cached_tokens", None) or 0)
    write = int(getattr(details, "cache_write_tokens", None) or 0)
    prompt = int(given.prompt_tokens or 0)
    return Usage(max(prompt - read - write, 0), int(given.completion_tokens or 0), read, write)

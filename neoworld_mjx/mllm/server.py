"""Base class of the providers that call a server: optional features, streams, errors, replies."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import anthropic

from ..config import MLLMOptions, RoleOptions
from .connection import classified, configured_connection, server_message
from .requests import Rejection, Reply, Request, Transient, Usage, response_rule

_SCHEMA_IN_PROMPT = (
    "structured output is not supported (server or schema): the prompt has the schema"
)
_UNCOUNTED = "the server gave no token counts: the ledger has their upper bound"


@dataclass
class Received:
    """The part of a streamed response that has arrived."""

    model: str
    text: str = ""
    usage: Usage | None = None
    """Token counts; None until the server sends them."""
    stop: Literal["end", "length", "refusal"] | None = None
    """Reason why the response ended; None until the response is complete."""
    refusal: str = ""
    """Message of the server about a refusal."""


class ServerProvider(ABC):
    """A provider that calls a server's API and streams the responses.

    The timeout limits the time without data; `Calls` limits the duration of a whole call. Once a
    server rejects an optional feature (a JSON schema for the response, token counts in the stream,
    ...), later calls omit the feature.

    Args:
        options: models, base_url, headers and time limit.

    Raises:
        ConfigError: a header needs an environment variable that is not set.
        ModelError: there is neither a key nor a base_url.
    """

    name: ClassVar[str]
    key_name: ClassVar[str]
    url_name: ClassVar[str]
    schema_feature: ClassVar[str]
    """Parameter that contains the JSON schema of the response."""
    features: ClassVar[Mapping[str, Sequence[str]]]
    """Optional parameters, each with the words that refer to it in a server's error message."""
    online = True

    def __init__(self, options: MLLMOptions) -> None:
        self._connection = configured_connection(options, self.key_name, self.url_name)
        self.secrets = self._connection.secrets
        self._client: Any = None
        self._unsupported: set[tuple[str, str, str]] = set()
        """Rejected features as (model, feature, digest of the schema or "")."""

    @abstractmethod
    def _new_client(self) -> Any:
        """Return a client of the SDK that does not retry, so that the ledger counts every call."""

    @abstractmethod
    def _params(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> dict[str, Any]:
        """Return the parameters of a call."""

    @abstractmethod
    async def _receive(self, params: dict[str, Any], received: Received) -> None:
        """Make a call and write its stream into `received`."""

    async def reply(
        self, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        """Make one call; if the server rejects a feature, repeat the call without the feature.

        Raises:
            Transient: a retry may help.
            ModelError: a retry cannot help; the message states a remedy.
        """
        while True:
            params = self._params(request, role, rejected)
            received = Received(role.model)
            try:
                await self._receive(params, received)
            except Exception as error:
                feature = self._rejected_feature(error, params)
                rejected_feature = (role.model, feature or "", self._scope(feature, request))
                if feature is None or rejected_feature in self._unsupported:
                    usage = received.usage or Usage()
                    raise classified(error, self._connection, request.role, role, usage) from None
                self._unsupported.add(rejected_feature)
                continue
            if received.stop is None:
                raise Transient("the response broke off before its end", usage=received.usage)
            notes = [] if self.schema_feature in params else [_SCHEMA_IN_PROMPT]
            if received.usage is None:
                notes.append(_UNCOUNTED)
            return Reply(
                received.text,
                received.usage or Usage(),
                received.model,
                received.stop,
                received.refusal,
                "; ".join(notes) or None,
                counted=received.usage is not None,
            )

    async def close(self) -> None:
        """Close the connections."""
        client, self._client = self._client, None
        if client is not None:
            await client.close()

    def _open(self) -> Any:
        if self._client is None:
            self._client = self._new_client()
        return self._client

    def _supports(self, feature: str, request: Request[Any], role: RoleOptions) -> bool:
        return (role.model, feature, self._scope(feature, request)) not in self._unsupported

    def _scope(self, feature: str | None, request: Request[Any]) -> str:
        # A server may reject one schema and accept another.
        return request.parts["schema"] if feature == self.schema_feature else ""

    def _rejected_feature(self, error: Exception, params: dict[str, Any]) -> str | None:
        """Return the optional feature that a server rejects; None if it rejects none."""
        if getattr(error, "status_code", None) not in (400, 422):
            return None
        message = server_message(error).lower()
        for feature, words in self.features.items():
            if feature in params and any(word in message for word in words):
                return feature
        return None

    def _schema(self, request: Request[Any], role: RoleOptions) -> dict[str, Any] | None:
        """Return the schema for the server to enforce; None if the server cannot enforce it."""
        if not self._supports(self.schema_feature, request, role):
            return None
        try:
            return anthropic.transform_schema(request.json_schema)
        except ValueError:
            return None  # Structured output cannot express the schema, such as a field of any type.

    def _prompt(self, request: Request[Any], schema: dict[str, Any] | None) -> str:
        # A local server may accept a schema without enforcing it.
        if schema is not None and not self._connection.local:
            return request.prompt
        return f"{request.prompt}\n\n{response_rule(request)}"


def corrections(request: Request[Any], rejected: Sequence[Rejection]) -> list[tuple[str, str]]:
    """Return the rejected responses and their errors as messages (role, text) after the prompt."""
    turns = []
    for rejection in rejected:
        turns.append(("assistant", rejection.text.strip() or "(nothing)"))
        turns.append(("user", rejection.message(request)))
    return turns

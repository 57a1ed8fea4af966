"""A model with given answers, for tests of the steps that send requests."""

import json
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel

from neoworld_mjx.errors import ModelError
from neoworld_mjx.mllm import Request, Response, Usage
from neoworld_mjx.mllm.requests import InvalidResponse, Reply, read_response


class ScriptedModel:
    """Gives its answers in order, raising exceptions among them, and records the requests.

    It is a `Model` by itself, and a `Provider` for a panel.

    Args:
        answers: pydantic models, JSON values, or exceptions.
    """

    name, online, secrets = "scripted", False, ()

    def __init__(self, *answers: Any) -> None:
        self.answers = list(answers)
        self.requests: list[Request[Any]] = []

    async def ask(self, request: Request[Any]) -> Response[Any]:
        text = self._next(request)
        try:
            value = read_response(text, request.schema)
        except InvalidResponse as error:
            raise ModelError(str(error)) from None
        return Response(value, text, Usage(), self.name)

    async def reply(self, request: Request[Any], role: Any, rejected: Sequence[Any]) -> Reply:
        return Reply(self._next(request), Usage(), self.name)

    async def close(self) -> None: ...

    def _next(self, request: Request[Any]) -> str:
        self.requests.append(request)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer.model_dump_json() if isinstance(answer, BaseModel) else json.dumps(answer)

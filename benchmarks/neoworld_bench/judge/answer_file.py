"""Responses of a judge, requested concurrently and stored."""

import asyncio
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from neoworld_mjx.errors import BudgetError, MissingResponseError, ModelError, RunError
from neoworld_mjx.io.files import write_atomic
from neoworld_mjx.mllm import Panel, Picture, Request, Response

T = TypeVar("T", bound=BaseModel)
ANSWERS = "answers.json"


def answers_to(models: Panel, requests: Sequence[Request[T]]) -> list[Response[T] | ModelError]:
    """Send requests concurrently; a refusal or invalid response becomes its error.

    Raises:
        BudgetError: the cost cap is reached.
        MissingResponseError: a tape lacks a response.
    """

    async def one(request: Request[T]) -> Response[T] | ModelError:
        try:
            return await models.ask(request)
        except (BudgetError, MissingResponseError):
            raise
        except ModelError as error:
            return error

    async def together() -> list[Response[T] | ModelError]:
        return await asyncio.gather(*map(one, requests))

    return models.run(together())


def save_pictures(folder: Path, name: str, pictures: Sequence[Picture]) -> None:
    """Write the images of a request as NAME-LABEL.png into a folder.

    Raises:
        RunError: a file cannot be written.
    """
    for picture in pictures:
        file = folder / f"{name}-{picture.label}.png"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_atomic(file, picture.data)
        except OSError as error:
            raise RunError(f"cannot write {file}: {error.strerror}") from None


class AnswerFile:
    """File answers.json: name, key, model and raw responses of each request.

    Args:
        folder: where the file is written after every response; None writes none.
    """

    def __init__(self, folder: Path | None) -> None:
        self._file = None if folder is None else folder / ANSWERS
        self._entries: list[dict[str, Any]] = []

    def add(self, request: Request[Any], answer: Response[Any] | ModelError) -> None:
        """Add the response to a request.

        Raises:
            RunError: the file cannot be written.
        """
        entry: dict[str, Any] = {"name": request.name, "key": request.key}
        if isinstance(answer, ModelError):
            entry |= {"valid": False, "why": str(answer), "texts": list(answer.texts)}
        else:
            entry |= {"valid": True, "model": answer.model, "texts": [answer.text]}
        self._entries.append(entry)
        if self._file is None:
            return
        text = json.dumps(self._entries, indent=1, ensure_ascii=False) + "\n"
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(self._file, text)
        except OSError as error:
            raise RunError(f"cannot write {self._file}: {error.strerror}") from None

"""Estimated tokens of the requests that a tape answers, and their price with other models."""

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

from neoworld_mjx.config import RoleOptions
from neoworld_mjx.mllm.replay import Replay
from neoworld_mjx.mllm.requests import Rejection, Reply, Request, Usage

CHARACTERS_A_TOKEN = 4.0
PIXELS_A_TOKEN, LONGEST_PX = 750.0, 1568.0
"""Pixels of an image per token, and the longer side that servers resize larger images to."""


@contextmanager
def estimated_usages() -> Iterator[list[Usage]]:
    """Collect the estimated tokens of each response that a tape gives.

    Reasoning tokens and the servers' own counts are unknown: a token is 4 characters of text or 750
    pixels of an image, and nothing is read from a cache.
    """
    usages: list[Usage] = []
    replied = Replay.reply

    async def counted(
        self: Replay, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        reply = await replied(self, request, role, rejected)
        usages.append(Usage(input_tokens(request), text_tokens(reply.text)))
        return reply

    with patch.object(Replay, "reply", counted):
        yield usages


def input_tokens(request: Request[Any]) -> int:
    """Return the estimated tokens of a request."""
    schema = json.dumps(request.json_schema)
    labels = "".join(picture.label for picture in request.pictures)
    text = text_tokens(request.system + request.prompt + schema + labels)
    return text + sum(picture_tokens(*picture.size) for picture in request.pictures)


def picture_tokens(width: int, height: int) -> int:
    """Return the estimated tokens of a picture [px]."""
    shrunk = min(1.0, LONGEST_PX / max(width, height))
    return math.ceil(width * height * shrunk**2 / PIXELS_A_TOKEN)


def text_tokens(text: str) -> int:
    """Return the estimated tokens of a text."""
    return math.ceil(len(text) / CHARACTERS_A_TOKEN)

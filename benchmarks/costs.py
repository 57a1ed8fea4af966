"""Estimated cost of a photograph: tokens and prices of the bundled examples' requests."""

import json
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

from benchmarks.suites import Costs
from neoworld_mjx.config import RoleOptions, load_config
from neoworld_mjx.mllm import load_prices
from neoworld_mjx.mllm.replay import Replay
from neoworld_mjx.mllm.requests import Rejection, Reply, Request, Usage
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.pipeline.bundled_examples import bundled_examples

CHARACTERS_A_TOKEN = 4.0
PIXELS_A_TOKEN, LONGEST_PX = 750.0, 1568.0
"""Pixels of an image per token, and the longer side that servers resize larger images to."""


def run_suite(options: Costs) -> dict[str, Any]:
    """Replay the examples, and estimate tokens and dollars from their requests and responses.

    Reasoning tokens and the servers' own counts are unknown: a token is 4 characters of text or 750
    pixels of an image, and nothing is read from a cache.
    """
    rows = []
    for name, example in bundled_examples().items():
        usages = _usages(example.photo, options)
        total = sum(usages, Usage())
        row = {"example": name, "calls": len(usages), "input": total.input, "output": total.output}
        prices = {model: round(load_prices()[model].cost(total), 4) for model in options.model}
        rows.append(row | {f"usd {model}": dollars for model, dollars in prices.items()})
    return {"rows": rows}


def _usages(photo: Path, options: Costs) -> list[Usage]:
    usages: list[Usage] = []
    replied = Replay.reply

    async def counted(
        self: Replay, request: Request[Any], role: RoleOptions, rejected: Sequence[Rejection]
    ) -> Reply:
        reply = await replied(self, request, role, rejected)
        usages.append(Usage(_input_tokens(request), _text_tokens(reply.text)))
        return reply

    config = load_config(overrides={"provider": "replay"})
    with tempfile.TemporaryDirectory() as place, patch.object(Replay, "reply", counted):
        reconstruct(photo, Path(place) / "out", config, until="verify")
    return usages


def _input_tokens(request: Request[Any]) -> int:
    schema = json.dumps(request.json_schema)
    labels = "".join(picture.label for picture in request.pictures)
    text = _text_tokens(request.system + request.prompt + schema + labels)
    return text + sum(_picture_tokens(*picture.size) for picture in request.pictures)


def _picture_tokens(width: int, height: int) -> int:
    shrunk = min(1.0, LONGEST_PX / max(width, height))
    return math.ceil(width * height * shrunk**2 / PIXELS_A_TOKEN)


def _text_tokens(text: str) -> int:
    return math.ceil(len(text) / CHARACTERS_A_TOKEN)

"""Estimates of tokens and prices of requests."""

from typing import Any

import numpy as np
from neoworld_bench.photographs.token_estimates import (
    input_tokens,
    picture_tokens,
    text_tokens,
)
from pydantic import BaseModel

from neoworld_mjx.mllm import Picture, Request


class Reply(BaseModel):
    """An answer."""

    name: str


def test_image_tokens_follow_the_servers_resizing():
    assert picture_tokens(750, 100) == 100
    assert picture_tokens(3136, 1568) == picture_tokens(1568, 784) == 1640


def test_request_tokens_are_those_of_texts_schema_and_images():
    plain: Any = Request(role="critic", name="a", system="s" * 400, prompt="p" * 400, schema=Reply)
    schema = input_tokens(plain) - 200
    assert 0 < schema < 60 and text_tokens("x" * 9) == 3
    picture = Picture.of("", np.zeros((100, 750, 3), np.uint8))
    seen: Any = Request(
        role="critic",
        name="a",
        system="s" * 400,
        prompt="p" * 400,
        schema=Reply,
        pictures=[picture],
    )
    assert input_tokens(seen) == input_tokens(plain) + 100

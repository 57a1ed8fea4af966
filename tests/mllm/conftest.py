"""Small requests that the tests of this folder share."""

from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import BaseModel

from neoworld_mjx.mllm import Picture, Request


class Colour(BaseModel):
    name: str


class Shade(BaseModel):
    name: str
    depth: float


def noise(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (20, 30, 3), dtype=np.uint8)


def request_of(**changes) -> Request:
    given = {
        "role": "reasoner",
        "name": "parse",
        "system": "You see.",
        "prompt": "Which colour?",
        "schema": Colour,
        "pictures": [Picture.of("photo", noise())],
    }
    return Request(**(given | changes))


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    return SimpleNamespace(request=request_of, noise=noise, Colour=Colour, Shade=Shade)

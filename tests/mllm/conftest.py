"""Small requests that the tests of this folder share."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import wait
from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import BaseModel

from neoworld_mjx.config import MLLMOptions
from neoworld_mjx.mllm import Panel, Picture, Request, Response, open_panel
from tests.support.model_server import ModelServer, Script

KEY = "sk-test-0123456789-do-not-show"


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
        "pictures": [Picture("photo", noise())],
    }
    return Request(**(given | changes))


def ask_all(panel: Panel, requests: Sequence[Request]) -> list[Response]:
    """Ask all requests at once; raise the first failure when all have ended."""
    futures = [panel.ask_soon(request) for request in requests]
    wait(futures)
    return [future.result() for future in futures]


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    return SimpleNamespace(request=request_of, noise=noise, Colour=Colour, Shade=Shade)


@pytest.fixture
def connect(monkeypatch) -> Iterator[Callable[..., tuple[ModelServer, Panel]]]:
    """Return a function that starts a server with its scripts and opens a panel to it."""
    monkeypatch.setenv("ANTHROPIC_API_KEY", KEY)
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    with ExitStack() as stack:

        def start(dialect, *scripts: Script, server=None, record=None, **options):
            sdk = pytest.importorskip(f"{dialect}._base_client")
            monkeypatch.setattr(sdk, "INITIAL_RETRY_DELAY", 0.001)
            server = server or stack.enter_context(ModelServer(dialect, *scripts))
            given = {"base_url": server.url} | options
            panel = open_panel(MLLMOptions(**given), dialect, record=record)
            return server, stack.enter_context(panel)

        yield start

"""Model servers of a seed that redirect, unpack to much, trickle or send bytes at random."""

import os
import random
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from neoworld_mjx.config import MLLMOptions
from neoworld_mjx.mllm import Picture, Request, open_panel
from tests.support.model_server import ModelServer, Script, http, stream_of

KEY = "sk-generated-0123456789"


class Answer(BaseModel):
    """Schema of the response."""

    name: str


def server(draw: random.Random, home: Path) -> None:
    """Ask a hostile server; the key must not reach the one that it redirects to."""
    keys = ("ANTHROPIC_API_KEY", "OPENAI_API_KEY", "GENERATED_KEY")
    os.environ.update(dict.fromkeys(keys, KEY))
    dialect: Any = draw.choice(["anthropic", "openai"])
    other = ModelServer(dialect, lambda server, connection, body: None)
    with other, ModelServer(dialect, _script(draw, dialect, other.url)) as hostile:
        options = MLLMOptions(
            base_url=hostile.url,
            timeout_s=1.0,
            call_timeout_s=2.0,
            retries=draw.randint(0, 1),
            headers={"api-key": "${GENERATED_KEY}"},
        )
        picture = Picture.of("photo", np.zeros((8, 8, 3), np.uint8))
        request = Request(
            role="reasoner", name="parse", system="", prompt="?", schema=Answer, pictures=[picture]
        )
        with open_panel(options, dialect) as panel:
            panel._calls.backoff_s = 0.01
            try:
                panel.ask_sync(request)
            finally:
                assert not other.headers, "the server that was redirected to was asked"


def _script(draw: random.Random, dialect: str, other: str) -> Script:
    make: Callable[[random.Random, str, str], Script] = draw.choice(
        [_redirect, _packed, _trickle, _garbage]
    )
    return make(draw, dialect, other)


def _redirect(draw: random.Random, dialect: str, other: str) -> Script:
    targets = [f"{other}/v1", other.replace("127.0.0.1", "localhost"), "//[::1]:1/", "/again"]
    targets += ["https://evil.invalid/", "file:///etc/passwd", "http://", "\\\\evil", "x" * 5000]
    status, target = draw.choice([301, 302, 303, 307, 308]), draw.choice(targets)
    return _sent(http(status, "", headers=f"location: {target}\r\n"))


def _packed(draw: random.Random, dialect: str, other: str) -> Script:
    status, mebibytes = draw.choice([200, 200, 400, 500]), draw.choice([1, 40, 200])
    piece = draw.choice([b": ping\n\n", b"x", b"data: {}\n\n", b"\n", bytes(1)])
    coding, bits = draw.choice([("gzip", 31), ("deflate", 15), ("deflate", -15)])
    pack = zlib.compressobj(1, zlib.DEFLATED, bits)
    filled = piece * ((1 << 20) // len(piece))
    data = b"".join(pack.compress(filled) for _ in range(mebibytes)) + pack.flush()
    twice = draw.random() < 0.3
    if twice:
        pack = zlib.compressobj(1, zlib.DEFLATED, bits)
        data = pack.compress(data) + pack.flush()
    names = f"{coding}, {coding}" if twice else coding
    head = (
        f"HTTP/1.1 {status} X\r\ncontent-type: text/event-stream\r\ncontent-encoding: {names}\r\n"
        f"content-length: {len(data)}\r\n\r\n"
    )
    return _sent(head.encode() + data)


def _trickle(draw: random.Random, dialect: str, other: str) -> Script:
    whole = stream_of(dialect, "m", "x" * 700)
    start = whole[: draw.randrange(len(whole))]
    piece = draw.choice([": ping\n\n", "x", "\n", " ", "data: 1\n\n", start[-100:]]).encode()
    wait, size = draw.choice([0.0, 0.001, 0.05, 0.5]), draw.choice([1, 1, 1000])

    def play(server: ModelServer, connection: Any, body: Any) -> None:
        connection.sendall(b"HTTP/1.1 200 X\r\ncontent-type: text/event-stream\r\n\r\n")
        connection.sendall(start.encode())
        end = time.monotonic() + 6.0
        while time.monotonic() < end and not server.closing.wait(wait):
            connection.sendall(piece * size)

    return play


def _garbage(draw: random.Random, dialect: str, other: str) -> Script:
    whole = bytearray(http(200, stream_of(dialect, "m", '{"name": "a"}'), kind="text/event-stream"))
    for _ in range(draw.randint(1, 8)):
        whole[draw.randrange(len(whole))] = draw.randrange(256)
    return _sent(bytes(whole))


def _sent(data: bytes) -> Script:
    return lambda server, connection, body: connection.sendall(data)

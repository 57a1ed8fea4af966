"""A local server that speaks the Messages API, as slow and as unreliable as it is told to be.

It answers scoring requests by the picture that it is shown, so that whoever asks can tell whether an
answer has come to the right place. Which calls fail depends on the picture and on how often it was
sent, not on the order in which calls come.
"""

import base64
import contextlib
import hashlib
import io
import json
import socket
import socketserver
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, Literal, Self

import numpy as np
from PIL import Image

from neoworld_mjx.refinement.ask_scores import CRITERIA

Failure = Literal["429", "500", "cut off", "invalid JSON"]
FAILURES: tuple[Failure, ...] = ("429", "500", "cut off", "invalid JSON")


def levels_of(rgb: np.ndarray) -> dict[str, int]:
    """Return the levels 0 to 4 that the server gives a picture, uint8 [height, width, 3]."""
    data = hashlib.sha256(f"{rgb.shape}".encode() + np.ascontiguousarray(rgb).tobytes()).digest()
    return {name: data[k] % 5 for k, name in enumerate(CRITERIA)}


def judged(rgb: np.ndarray) -> str:
    """Phrase the judgement of a picture as a model answers it."""
    levels = levels_of(rgb)
    return json.dumps({n: {"reason": f"Seen as {v}.", "level": v} for n, v in levels.items()})


class MessagesServer:
    """The server; a context manager that listens on loopback.

    Args:
        answer: gives the text about the last picture of a request, uint8 [height, width, 3].
        delay_s: how long every call takes.
        at_once: calls beyond so many wait for their turn.
        failing: share of calls that fail, the four ways in equal parts.
        seed: which ones do.
    """

    def __init__(
        self,
        answer: Callable[[np.ndarray], str] = judged,
        *,
        delay_s: float = 3.0,
        at_once: int = 8,
        failing: float = 0.1,
        seed: int = 0,
    ) -> None:
        self.answer, self.delay_s, self.failing, self.seed = answer, delay_s, failing, seed
        self.calls = 0
        self.failures: Counter[str] = Counter()
        self.first_pictures: set[str] = set()
        """Digests of the pictures that came first in requests."""
        self.sent: Counter[str] = Counter()
        """How often each last picture came."""
        self.most_at_once = 0
        self._now = 0
        self._lock = threading.Lock()
        self._gate = threading.Semaphore(at_once)

    @property
    def url(self) -> str:
        """The base URL."""
        return f"http://127.0.0.1:{self._tcp.server_address[1]}"

    def __enter__(self) -> Self:
        served = self

        class Connection(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                with contextlib.suppress(OSError):
                    served._serve(self.request)

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = True
            daemon_threads = True
            block_on_close = False
            request_queue_size = 64

        self._tcp = Server(("127.0.0.1", 0), Connection)
        threading.Thread(target=self._tcp.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._tcp.shutdown()
        self._tcp.server_close()

    def _serve(self, connection: socket.socket) -> None:
        file = connection.makefile("rb")
        if not file.readline():
            return
        length = 0
        for line in iter(file.readline, b"\r\n"):
            name, _, value = line.decode().partition(":")
            if name.lower() == "content-length":
                length = int(value)
        body = json.loads(file.read(length))
        images = [
            block["source"]["data"]
            for block in body["messages"][0]["content"]
            if block["type"] == "image"
        ]
        last = hashlib.sha256(images[-1].encode()).hexdigest()
        with self._lock:
            self.calls += 1
            self.sent[last] += 1
            self.first_pictures.add(hashlib.sha256(images[0].encode()).hexdigest())
            failure = self._failure(last, self.sent[last])
            if failure is not None:
                self.failures[failure] += 1
        with self._gate:
            with self._lock:
                self._now += 1
                self.most_at_once = max(self.most_at_once, self._now)
            try:
                time.sleep(self.delay_s)
                self._reply(connection, body, images[-1], failure)
            finally:
                with self._lock:
                    self._now -= 1

    def _failure(self, picture: str, attempt: int) -> Failure | None:
        draw = hashlib.sha256(f"{self.seed}:{picture}:{attempt}".encode()).digest()
        if int.from_bytes(draw[:4], "big") / 2**32 >= self.failing:
            return None
        return FAILURES[draw[4] % len(FAILURES)]

    def _reply(
        self, connection: socket.socket, body: dict[str, Any], image: str, failure: Failure | None
    ) -> None:
        if failure in ("429", "500"):
            error = {"type": "error", "error": {"type": "some_error", "message": "no luck"}}
            connection.sendall(_http(int(failure), json.dumps(error), "application/json"))
            return
        with Image.open(io.BytesIO(base64.b64decode(image))) as picture:
            text = self.answer(np.array(picture.convert("RGB")))
        if failure == "invalid JSON":
            text = text.replace(":", "=", 3)
        data = _http(200, _stream(body["model"], text), "text/event-stream")
        connection.sendall(data[: len(data) // 2] if failure == "cut off" else data)


def _http(status: int, body: str, kind: str) -> bytes:
    data = body.encode()
    head = (
        f"HTTP/1.1 {status} X\r\ncontent-type: {kind}\r\nconnection: close\r\n"
        f"content-length: {len(data)}\r\n\r\n"
    )
    return head.encode() + data


def _stream(model: str, text: str) -> str:
    usage = {
        "input_tokens": 700,
        "output_tokens": 1,
        "cache_read_input_tokens": 2500,
        "cache_creation_input_tokens": 0,
    }
    message = {
        "id": "m",
        "type": "message",
        "role": "assistant",
        "model": model,
        "content": [],
        "stop_reason": None,
        "stop_sequence": None,
        "usage": usage,
    }
    delta = {"type": "text_delta", "text": text}
    events: list[dict[str, Any]] = [
        {"type": "message_start", "message": message},
        {"type": "content_block_start", "index": 0, "content_block": {"type": "text", "text": ""}},
        {"type": "content_block_delta", "index": 0, "delta": delta},
        {"type": "content_block_stop", "index": 0},
        {
            "type": "message_delta",
            "delta": {"stop_reason": "end_turn", "stop_sequence": None},
            "usage": {"output_tokens": 250},
        },
        {"type": "message_stop"},
    ]
    return "".join(f"event: {e['type']}\ndata: {json.dumps(e)}\n\n" for e in events)

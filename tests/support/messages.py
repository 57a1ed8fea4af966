"""A scoring model behind the Messages API, with a given delay and share of failures.

Its answer depends on the picture of the request, so that callers can check that each answer reached
the right candidate. Failures depend on the picture and its number of calls, not on the order of
calls.
"""

import base64
import hashlib
import io
import json
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from PIL import Image

from neoworld_mjx.search.scorer import CRITERIA
from tests.support.model_server import ModelServer, answer_of, fails, http

Failure = Literal["429", "500", "cut off", "invalid JSON"]
FAILURES: tuple[Failure, ...] = ("429", "500", "cut off", "invalid JSON")


def levels_of(rgb: np.ndarray) -> dict[str, int]:
    """Return the levels 0 to 4 that the server gives a picture, uint8 [height, width, 3]."""
    data = hashlib.sha256(f"{rgb.shape}".encode() + np.ascontiguousarray(rgb).tobytes()).digest()
    return {name: data[k] % 5 for k, name in enumerate(CRITERIA)}


def judged(rgb: np.ndarray) -> str:
    """Return the judgement of a picture in the words of a model."""
    levels = levels_of(rgb)
    return json.dumps({n: {"reason": f"Seen as {v}.", "level": v} for n, v in levels.items()})


class MessagesServer(ModelServer):
    """The server; a context manager that listens on loopback.

    Args:
        answer: gives the text about the last picture of a request, uint8 [height, width, 3].
        delay_s: duration of every call.
        at_once: calls beyond so many wait for their turn.
        failing: share of calls that fail, the four ways in equal parts.
        seed: of the choice of calls that fail.
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
        super().__init__("anthropic", MessagesServer._play)
        self.answer, self.delay_s, self.failing, self.seed = answer, delay_s, failing, seed
        self.failures: Counter[str] = Counter()
        self.first_pictures: set[str] = set()
        """Digests of the pictures that came first in requests."""
        self.sent: Counter[str] = Counter()
        """How often each last picture came."""
        self.most_served_at_once = 0
        self._served_at_once = 0
        self._gate = threading.Semaphore(at_once)

    @property
    def calls(self) -> int:
        """Number of calls so far."""
        return self.sent.total()

    def _play(self, connection: socket.socket, body: dict[str, Any]) -> None:
        images = [
            block["source"]["data"]
            for block in body["messages"][0]["content"]
            if block["type"] == "image"
        ]
        last = hashlib.sha256(images[-1].encode()).hexdigest()
        with self.lock:
            self.sent[last] += 1
            self.first_pictures.add(hashlib.sha256(images[0].encode()).hexdigest())
            failure = self._failure(last, self.sent[last])
            if failure is not None:
                self.failures[failure] += 1
        with self._gate:
            with self.lock:
                self._served_at_once += 1
                self.most_served_at_once = max(self.most_served_at_once, self._served_at_once)
            try:
                time.sleep(self.delay_s)
                self._reply(connection, body, images[-1], failure)
            finally:
                with self.lock:
                    self._served_at_once -= 1

    def _failure(self, picture: str, attempt: int) -> Failure | None:
        draw = hashlib.sha256(f"{self.seed}:{picture}:{attempt}".encode()).digest()
        if int.from_bytes(draw[:4], "big") / 2**32 >= self.failing:
            return None
        return FAILURES[draw[4] % len(FAILURES)]

    def _reply(
        self, connection: socket.socket, body: dict[str, Any], image: str, failure: Failure | None
    ) -> None:
        if failure in ("429", "500"):
            fails(int(failure))(self, connection, body)
            return
        with Image.open(io.BytesIO(base64.b64decode(image))) as picture:
            text = self.answer(np.array(picture.convert("RGB")))
        if failure == "invalid JSON":
            text = text.replace(":", "=", 3)
        whole = answer_of("anthropic", body["model"], text, usage=(700, 250), cache_read=2500)
        data = http(200, whole)
        connection.sendall(data[: len(data) // 2] if failure == "cut off" else data)

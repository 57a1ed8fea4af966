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
        failing: share of calls that fail, the four ways in equal parts.
    """

    def __init__(
        self,
        answer: Callable[[np.ndarray], str] = judged,
        *,
        delay_s: float = 0.0,
        failing: float = 0.0,
    ) -> None:
        super().__init__("anthropic", MessagesServer._play)
        self.answer, self.delay_s, self.failing = answer, delay_s, failing
        self.sent: Counter[str] = Counter()
        """How often each last picture came."""

    def _play(self, connection: socket.socket, body: dict[str, Any]) -> None:
        blocks = body["messages"][0]["content"]
        image = [block["source"]["data"] for block in blocks if block["type"] == "image"][-1]
        key = hashlib.sha256(image.encode()).hexdigest()
        with self.lock:
            self.sent[key] += 1
            failure = self._failure(key, self.sent[key])
        time.sleep(self.delay_s)
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

    def _failure(self, picture: str, attempt: int) -> Failure | None:
        draw = hashlib.sha256(f"0:{picture}:{attempt}".encode()).digest()
        if int.from_bytes(draw[:4], "big") / 2**32 >= self.failing:
            return None
        return FAILURES[draw[4] % len(FAILURES)]

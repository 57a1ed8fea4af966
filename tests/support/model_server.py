"""A local server that speaks the Messages API or the chat completions API and misbehaves on demand.

It writes raw HTTP to its sockets, so that it can reset, hang and cut off in the middle of a body.
"""

import contextlib
import json
import socket
import socketserver
import struct
import threading
from collections.abc import Callable
from typing import Any, Literal, Self

GOOD = '{"name": "red"}'
Script = Callable[[Any, socket.socket, dict[str, Any]], None]


class ModelServer:
    """The server; a context manager that listens on loopback and keeps the requests.

    Args:
        dialect: the API that it speaks.
        scripts: one answers each call, the last one all further calls.
    """

    def __init__(self, dialect: Literal["anthropic", "openai"], *scripts: Script) -> None:
        self.dialect = dialect
        self.scripts = list(scripts)
        self.paths: list[str] = []
        self.headers: list[dict[str, str]] = []
        self.bodies: list[dict[str, Any]] = []
        self.most_at_once = 0
        self.lock = threading.Lock()
        self.closing = threading.Event()
        self._at_once = 0

    def __enter__(self) -> Self:
        serve = self._serve

        class Connection(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                with contextlib.suppress(OSError):
                    serve(self.request)

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = True
            daemon_threads = True
            block_on_close = False
            request_queue_size = 64

        self._tcp = Server(("127.0.0.1", 0), Connection)
        threading.Thread(target=self._tcp.serve_forever, args=(0.02,), daemon=True).start()
        path = "/v1" if self.dialect == "openai" else ""
        self.url = f"http://127.0.0.1:{self._tcp.server_address[1]}{path}"
        return self

    def __exit__(self, *exc: object) -> None:
        self.closing.set()
        self._tcp.shutdown()
        self._tcp.server_close()

    def _serve(self, connection: socket.socket) -> None:
        file = connection.makefile("rb")
        path = file.readline().split(b" ")[1:2]
        if not path:
            return
        headers = {}
        for line in iter(file.readline, b"\r\n"):
            name, _, value = line.decode().partition(":")
            headers[name.lower()] = value.strip()
        length = int(headers.get("content-length", 0))
        body = json.loads(file.read(length)) if length else {}
        with self.lock:
            self.paths.append(path[0].decode())
            self.headers.append(headers)
            self.bodies.append(body)
            script = self.scripts.pop(0) if len(self.scripts) > 1 else self.scripts[0]
            self._at_once += 1
            self.most_at_once = max(self.most_at_once, self._at_once)
        try:
            script(self, connection, body)
        finally:
            with self.lock:
                self._at_once -= 1


def http(status: int, body: str, *, headers: str = "", cut: int = 0) -> bytes:
    """Return a response; `cut` bytes of the body that its header announces are missing."""
    data = body.encode()
    head = (
        f"HTTP/1.1 {status} X\r\ncontent-type: application/json\r\nconnection: close\r\n"
        f"content-length: {len(data)}\r\n{headers}\r\n"
    )
    return head.encode() + (data[:-cut] if cut else data)


def answer_of(
    dialect: str,
    model: str,
    text: str,
    stop: str = "end",
    usage: tuple[int, int] = (100, 20),
    *,
    cache_read: int = 0,
) -> str:
    """Return the body of an answer; usage is (input, output) tokens."""
    if dialect == "anthropic":
        counts = dict(zip(("input_tokens", "output_tokens"), usage, strict=True))
        counts |= {"cache_read_input_tokens": cache_read, "cache_creation_input_tokens": 0}
        reason = {"end": "end_turn", "length": "max_tokens"}.get(stop, stop)
        message = {"id": "m", "type": "message", "role": "assistant", "model": model}
        message |= {"content": [{"type": "text", "text": text}], "usage": counts}
        return json.dumps(message | {"stop_reason": reason, "stop_sequence": None})
    reason = {"end": "stop", "refusal": "content_filter"}.get(stop, stop)
    spoken = {"role": "assistant", "content": text}
    names = ("prompt_tokens", "completion_tokens", "total_tokens")
    completion = {"id": "c", "object": "chat.completion", "created": 1, "model": model}
    completion |= {"choices": [{"index": 0, "message": spoken, "finish_reason": reason}]}
    completion |= {"usage": dict(zip(names, (*usage, sum(usage)), strict=True))}
    return json.dumps(completion)


def says(text: str = GOOD, stop: str = "end", usage: tuple[int, int] = (100, 20)) -> Script:
    """Answer with a text."""

    def play(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
        whole = answer_of(server.dialect, body["model"], text, stop, usage)
        connection.sendall(http(200, whole))

    return play


def fails(status: int, message: str = "no luck", headers: str = "retry-after-ms: 1\r\n") -> Script:
    """Answer with an error."""
    error = {"type": "error", "error": {"type": "some_error", "message": message}}
    return sends(error, status, headers)


def sends(value: Any, status: int = 200, headers: str = "") -> Script:
    """Answer with a JSON value, or with a text as it is."""
    text = value if isinstance(value, str) else json.dumps(value)
    return lambda server, connection, body: connection.sendall(http(status, text, headers=headers))


def repeats(piece: bytes, wait_s: float = 0.0) -> Script:
    """Answer with an endless body."""

    def play(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
        connection.sendall(b"HTTP/1.1 200 X\r\ncontent-type: application/json\r\n\r\n")
        while not server.closing.wait(wait_s):
            connection.sendall(piece)

    return play


def resets(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
    """Reset the connection."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def hangs(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
    """Answer nothing until the server closes."""
    server.closing.wait(10)


def cuts_off(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
    """Send two thirds of the announced bytes."""
    whole = answer_of(server.dialect, body["model"], GOOD)
    connection.sendall(http(200, whole, cut=len(whole) // 3))

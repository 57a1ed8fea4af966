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


def http(
    status: int, body: str, *, kind: str = "application/json", headers: str = "", cut: int = 0
) -> bytes:
    """Return a response; `cut` bytes of the body that its header announces are missing."""
    data = body.encode()
    head = (
        f"HTTP/1.1 {status} X\r\ncontent-type: {kind}\r\nconnection: close\r\n"
        f"content-length: {len(data)}\r\n{headers}\r\n"
    )
    return head.encode() + (data[:-cut] if cut else data)


def stream_of(
    dialect: str,
    model: str,
    text: str,
    stop: str = "end",
    usage: tuple[int, int] = (100, 20),
    *,
    cache_read: int = 0,
) -> str:
    """Return the body of a streamed answer; usage is (input, output) tokens."""
    parts = [text[i : i + 7] for i in range(0, len(text), 7)]
    if dialect == "anthropic":
        message = {
            "id": "m",
            "type": "message",
            "role": "assistant",
            "model": model,
            "content": [],
            "stop_reason": None,
            "stop_sequence": None,
            "usage": {
                "input_tokens": usage[0],
                "output_tokens": 1,
                "cache_read_input_tokens": cache_read,
                "cache_creation_input_tokens": 0,
            },
        }
        reason = {"end": "end_turn", "length": "max_tokens", "refusal": "refusal"}[stop]
        block = {"type": "text", "text": ""}
        events: list[dict[str, Any]] = [
            {"type": "message_start", "message": message},
            {"type": "ping"},
            {"type": "content_block_start", "index": 0, "content_block": block},
            *(
                {
                    "type": "content_block_delta",
                    "index": 0,
                    "delta": {"type": "text_delta", "text": part},
                }
                for part in parts
            ),
            {"type": "content_block_stop", "index": 0},
            {
                "type": "message_delta",
                "delta": {"stop_reason": reason, "stop_sequence": None},
                "usage": {"output_tokens": usage[1]},
            },
            {"type": "message_stop"},
        ]
        return "".join(f"event: {e['type']}\ndata: {json.dumps(e)}\n\n" for e in events)
    reason = {"end": "stop", "length": "length", "refusal": "content_filter"}[stop]
    base = {"id": "c", "object": "chat.completion.chunk", "created": 1, "model": model}
    deltas = [({"role": "assistant", "content": part}, None) for part in parts] + [({}, reason)]
    chunks = [
        base | {"choices": [{"index": 0, "delta": delta, "finish_reason": finish}]}
        for delta, finish in deltas
    ]
    count = dict(
        zip(
            ("prompt_tokens", "completion_tokens", "total_tokens"),
            (*usage, sum(usage)),
            strict=True,
        )
    )
    chunks.append(base | {"choices": [], "usage": count})
    return "".join(f"data: {json.dumps(c)}\n\n" for c in chunks) + "data: [DONE]\n\n"


def says(text: str = GOOD, stop: str = "end", usage: tuple[int, int] = (100, 20)) -> Script:
    """Answer with a text."""

    def play(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
        whole = stream_of(server.dialect, body["model"], text, stop, usage)
        connection.sendall(http(200, whole, kind="text/event-stream"))

    return play


def fails(status: int, message: str = "no luck", headers: str = "") -> Script:
    """Answer with an error."""

    def play(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
        error = {"type": "error", "error": {"type": "some_error", "message": message}}
        connection.sendall(http(status, json.dumps(error), headers=headers))

    return play


def sends(value: Any, kind: str = "application/json") -> Script:
    """Answer with a JSON value, or with a text as it is."""
    text = value if isinstance(value, str) else json.dumps(value)
    return lambda server, connection, body: connection.sendall(http(200, text, kind=kind))


def resets(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
    """Reset the connection."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def hangs(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
    """Answer nothing until the server closes."""
    server.closing.wait(10)


def cuts_off(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
    """Send two thirds of the announced bytes."""
    whole = stream_of(server.dialect, body["model"], GOOD)
    connection.sendall(http(200, whole, kind="text/event-stream", cut=len(whole) // 3))


def ends_early(server: ModelServer, connection: socket.socket, body: dict[str, Any]) -> None:
    """Send half of a stream as if it were the whole."""
    whole = stream_of(server.dialect, body["model"], GOOD)
    connection.sendall(http(200, whole[: len(whole) // 2], kind="text/event-stream"))

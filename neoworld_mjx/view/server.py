"""Web server of the pages, which accepts only local clients by default, and HTML of the pages."""

import io
import logging
import re
import socket
from contextlib import redirect_stdout
from functools import partial
from html import escape
from typing import Any

from ..errors import RunError, expected_message
from ..io.names import printable

LOCAL = "127.0.0.1"
PORT = 8080
_HOSTS_OF_THIS_MACHINE = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
_PAGES_OF_THIS_MACHINE = re.compile(rf"https?://{_HOSTS_OF_THIS_MACHINE.pattern}")
_MAX_MESSAGE_BYTES = 1 << 20
"""Maximum size of a message from a page. The controls of a page send a few hundred bytes."""
_STYLE = (
    "<style>.nw{font-size:13px;line-height:1.45;padding:4px 10px}"
    ".nw .bad{color:#c0392b}.nw p{margin:4px 0}</style>"
)
_log = logging.getLogger(__name__)


def message(*lines: str, bad: bool = False) -> str:
    """Return lines of plain text as HTML, in red if `bad`."""
    style = "bad" if bad else ""
    paragraphs = "".join(f'<p class="{style}">{escape(printable(line))}</p>' for line in lines)
    return f'{_STYLE}<div class="nw">{paragraphs}</div>'


def failure(error: Exception) -> str:
    """Return the message of an error as HTML; the log has the traceback of an unexpected one."""
    expected = str(error) if isinstance(error, ValueError) else expected_message(error)
    if expected is None:
        _log.debug("an edit failed", exc_info=error)
        expected = f"internal error: {type(error).__name__}: {error}"
    return message(expected.partition("\n")[0], bad=True)


def open_server(label: str, *, host: str = LOCAL, port: int | None = None) -> Any:
    """Start a viser server.

    On a loopback address, the server rejects requests that name another host, and WebSocket
    connections from web pages of other origins in the same browser. A message of over 1 MiB closes
    its connection. The server never opens the tunnel to viser's public server.

    Args:
        label: title of the page.
        host: address to listen on; unless it is a loopback address, other machines can edit the
            scene.
        port: port to listen on; by default 8080 or, if 8080 is in use, any free port.

    Raises:
        RunError: viser is not installed, the port is in use, or the host is not an address of this
            machine.
    """
    try:
        import viser
        import websockets.asyncio.server
    except ImportError:
        raise RunError(
            "viser is not installed: install the extra `viewer`, such as by "
            "`uv sync --inexact --extra viewer`, or `pip install viser`"
        ) from None

    class LocalServer(viser.ViserServer):
        """Server without a tunnel to the internet."""

        def request_share_url(self, verbose: bool = True) -> str | None:
            """Return None instead of opening a tunnel."""
            return None

    chosen_port = _free_port(host, port)
    serve = websockets.asyncio.server.serve
    local = host in (LOCAL, "localhost", "::1")
    checked_serve: Any = partial(_serve_checked, serve, local)
    websockets.asyncio.server.serve = checked_serve
    try:
        with redirect_stdout(io.StringIO()):  # The constructor prints a table.
            server = LocalServer(host=host, port=chosen_port, label=printable(label), verbose=False)
    finally:
        websockets.asyncio.server.serve = serve
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    # The controls must not cover the photograph.
    server.gui.main_panel.dock_right()
    return server


def _serve_checked(serve: Any, local: bool, handler: Any, *address: Any, **options: Any) -> Any:
    """Call `websockets.asyncio.server.serve` with checks of requests and messages."""
    page = options["process_request"]

    def process_request(connection: Any, request: Any) -> Any:
        hosts = request.headers.get_all("Host")
        if local and not (len(hosts) == 1 and _HOSTS_OF_THIS_MACHINE.fullmatch(hosts[0])):
            return connection.respond(403, "this server accepts only requests to localhost\n")
        return page(connection, request)

    options |= {"process_request": process_request, "max_size": _MAX_MESSAGE_BYTES}
    if local:
        # None admits clients that are not browsers, which send no origin.
        options["origins"] = [None, _PAGES_OF_THIS_MACHINE]
    return serve(handler, *address, **options)


def close_server(server: Any) -> None:
    """Stop a server."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def address(server: Any) -> str:
    """Return the URL of the page for a browser on this machine."""
    host = server.get_host()
    host_name = "localhost" if host in (LOCAL, "0.0.0.0", "::") else host
    return f"http://{host_name}:{server.get_port()}"


def _free_port(host: str, port: int | None) -> int:
    reason = "none is free"
    for candidate in (PORT, 0) if port is None else (port,):
        try:
            with socket.create_server((host, candidate)) as probe:
                return int(probe.getsockname()[1])
        except OverflowError:
            raise RunError(
                f"--port {port}: give a port from 0 to 65535; 0 takes any free port"
            ) from None
        except OSError as error:
            reason = (error.strerror or str(error)).split(" (while")[0]
    raise RunError(f"cannot listen on {host} port {port or PORT}: {reason}; give another --port")

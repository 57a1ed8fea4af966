"""Web server of the pages; by default, it accepts only local clients."""

import io
import re
import socket
from contextlib import redirect_stdout
from functools import partial
from typing import Any

from ...errors import RunError

LOCAL = "127.0.0.1"
PORT = 8080
_PAGES_OF_THIS_MACHINE = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")


def open_server(label: str, *, host: str = LOCAL, port: int | None = None) -> Any:
    """Start a viser server.

    On a loopback address, the server refuses WebSocket connections from web pages of other origins
    in the same browser. It never opens the tunnel to viser's public server.

    Args:
        label: title of the page.
        host: address to listen on; unless it is a loopback address, other machines can edit the
            scene.
        port: port to listen on; by default 8080, or any free one if it is in use.

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
    if host in (LOCAL, "localhost", "::1"):
        # None admits clients other than browsers, which send no origin.
        checking_serve: Any = partial(serve, origins=[None, _PAGES_OF_THIS_MACHINE])
        websockets.asyncio.server.serve = checking_serve
    try:
        with redirect_stdout(io.StringIO()):  # The constructor prints a table.
            server = LocalServer(host=host, port=chosen_port, label=label, verbose=False)
    finally:
        websockets.asyncio.server.serve = serve
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    # The controls must not cover the photograph.
    server.gui.main_panel.dock_right()
    return server


def close_server(server: Any) -> None:
    """Stop a server."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def address(server: Any) -> str:
    """Return the URL of the page for a browser on this machine."""
    host = server.get_host()
    shown = "localhost" if host in (LOCAL, "0.0.0.0", "::") else host
    return f"http://{shown}:{server.get_port()}"


def _free_port(host: str, port: int | None) -> int:
    reason = "none is free"
    for candidate in (PORT, 0) if port is None else (port,):
        try:
            with socket.create_server((host, candidate)) as probe:
                return int(probe.getsockname()[1])
        except OverflowError:
            raise RunError(
                f"--port {port}: give one from 0 to 65535; 0 takes any free one"
            ) from None
        except OSError as error:
            reason = (error.strerror or str(error)).split(" (while")[0]
    raise RunError(f"cannot listen on {host} port {port or PORT}: {reason}; give another --port")

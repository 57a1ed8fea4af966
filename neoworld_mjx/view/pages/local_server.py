"""The web server of the pages: on this machine alone unless a host is named."""

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

    On this machine's own address only pages of this machine may talk to it: a web page from
    elsewhere, open in the same browser, is refused. The tunnel to viser's own server on the
    internet is refused always.

    Args:
        label: title of the page.
        host: address to listen on; any but the local one lets others change what is shown.
        port: to listen on; None takes 8080 or, where that is in use, any free one.

    Raises:
        RunError: viser is not installed, the port is in use or the address is none of this machine.
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
        """A server that no page can ask for a tunnel to the internet."""

        def request_share_url(self, verbose: bool = True) -> str | None:
            """Refuse."""
            return None

    chosen = _free_port(host, port)
    serve = websockets.asyncio.server.serve
    if host in (LOCAL, "localhost", "::1"):
        # None: a client that is no browser says no origin.
        checked: Any = partial(serve, origins=[None, _PAGES_OF_THIS_MACHINE])
        websockets.asyncio.server.serve = checked
    try:
        with redirect_stdout(io.StringIO()):  # It prints a table; the command says where it is.
            server = LocalServer(host=host, port=chosen, label=label, verbose=False)
    finally:
        websockets.asyncio.server.serve = serve
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    # Beside the picture: boxes are drawn on all of it.
    server.gui.main_panel.dock_right()
    return server


def close_server(server: Any) -> None:
    """Stop a server; its pages say that the connection is lost."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def address(server: Any) -> str:
    """Return the address to open in a browser on this machine."""
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
            raise RunError(f"--port {port}: name one from 0 to 65535; 0 is any free one") from None
        except OSError as error:
            reason = (error.strerror or str(error)).split(" (while")[0]
    raise RunError(f"cannot listen on {host} port {port or PORT}: {reason}; name another --port")

"""Clients that want more from the server of `neoworld view` and `annotate` than their pages do."""

import http.client
from contextlib import closing

import pytest

viser = pytest.importorskip("viser", reason="the extra viewer is not installed")
import msgspec  # noqa: E402
from viser._messages import GuiUpdateMessage  # noqa: E402
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from neoworld_mjx.view.server import close_server, open_server  # noqa: E402


@pytest.fixture(scope="module")
def port():
    server = open_server("test", port=0)
    yield server.get_port()
    close_server(server)


def client(port: int, **options):
    protocol = f"viser-v{viser.__version__}"
    return connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], **options)


def status_of(port: int, path: str, **headers: str) -> int:
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as connection:
        connection.request("GET", path, headers=headers)
        with connection.getresponse() as response:
            response.read()
            return response.status


def test_the_server_opens_no_tunnel():
    server = open_server("test", port=0)
    try:
        assert server.request_share_url() is None
    finally:
        close_server(server)


@pytest.mark.parametrize(
    ("path", "host", "statuses"),
    [
        ("/", "localhost:{port}", (200,)),
        *(("/", host, (403,)) for host in ("evil.example:8080", "127.0.0.1.evil.example", "")),
        *(
            (path, "localhost", (400, 404, 500))
            for path in ("/../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/etc/passwd", "/%00")
        ),
    ],
)
def test_requests_for_other_hosts_and_paths_are_refused(port, path, host, statuses):
    assert status_of(port, path, Host=host.format(port=port)) in statuses


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost.evil.example"])
def test_a_page_of_another_origin_is_refused(port, origin):
    with pytest.raises(InvalidStatus, match="403"), client(port, origin=origin):
        pass
    with client(port, origin=f"http://localhost:{port}") as connection:
        assert connection.recv(timeout=10)


def test_a_huge_message_closes_its_connection(port):
    with client(port) as connection:
        with pytest.raises(ConnectionClosed):
            connection.send(bytes(2 << 20))
            while True:
                connection.recv(timeout=10)
    with client(port) as connection:
        assert connection.recv(timeout=10)


@pytest.mark.parametrize("value", ["text", None, [1], {"a": 1}, b"x"])
def test_a_value_of_another_type_changes_nothing(value):
    server = open_server("test", port=0)
    try:
        control = server.gui.add_number("Height", 1.0)
        changes = []
        control.on_update(changes.append)
        update = GuiUpdateMessage(control._impl.uuid, {"value": value})
        with client(server.get_port()) as connection:
            connection.recv(timeout=10)
            connection.send(msgspec.msgpack.encode(update.as_serializable_dict()))
        with client(server.get_port()) as connection:
            assert connection.recv(timeout=10)
        assert control.value == 1.0 and not changes
    finally:
        close_server(server)

"""Clients that want more from the server of `neoworld view` and `annotate` than their pages do."""

import http.client
import socket
from contextlib import closing, suppress

import pytest

viser = pytest.importorskip("viser", reason="the extra viewer is not installed")
from neoworld_mjx.commands.view_command import (  # noqa: E402
    AnnotateCommand,
    PageCommand,
    ViewCommand,
)
from neoworld_mjx.view.pages.local_server import close_server, open_server  # noqa: E402
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from tests.faults.strikes import EXAMPLES  # noqa: E402
from tests.support.hostile import FINE  # noqa: E402


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
        assert server.get_host() == "127.0.0.1"
    finally:
        close_server(server)


@pytest.mark.parametrize("name", ["view", "annotate"])
def test_both_commands_open_this_server(name, tmp_path, monkeypatch):
    def probe(command, address):
        port = int(address.rpartition(":")[2])
        with client(port, origin=f"http://localhost:{port}") as connection:
            assert connection.recv(timeout=10)
        with pytest.raises(InvalidStatus), client(port, origin="http://evil.example"):
            pass
        return {hosts: status_of(port, "/", Host=hosts) for hosts in ("localhost", "evil.example")}

    monkeypatch.setattr(PageCommand, "serve_until_interrupted", probe)
    (tmp_path / "thing.py").write_text(FINE)
    commands = {
        "view": lambda: ViewCommand(target=tmp_path / "thing.py", port=0),
        "annotate": lambda: AnnotateCommand(
            photo=EXAMPLES / "coffee.png", out=tmp_path / "out", port=0
        ),
    }
    assert commands[name]().run() == {"localhost": 200, "evil.example": 403}


def test_only_this_machine_reaches_the_server(port):
    addresses = {str(info[4][0]) for info in socket.getaddrinfo(socket.gethostname(), None)}
    for address in addresses - {"127.0.0.1", "::1"}:
        if address.startswith("127."):
            continue
        with pytest.raises(OSError), socket.create_connection((address, port), timeout=2):
            pass


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", ""]
)
def test_a_request_for_another_host_is_refused(port, host):
    assert status_of(port, "/", Host=host) == 403
    assert status_of(port, "/", Host=f"localhost:{port}") == 200


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://localhost.evil.example", "file://"]
)
def test_a_page_of_another_origin_is_refused(port, origin):
    with pytest.raises(InvalidStatus, match="403"), client(port, origin=origin):
        pass
    with client(port, origin=f"http://localhost:{port}") as connection:
        assert connection.recv(timeout=10)


@pytest.mark.parametrize(
    "path",
    ["/../../../../../etc/passwd", "/%2e%2e/%2e%2e/%2e%2e/etc/passwd", "/..%5c..%5cetc/passwd",
     "//etc/passwd", "/etc/passwd", "/%00"],
)  # fmt: skip
def test_no_path_leads_out_of_the_page(port, path):
    assert status_of(port, path) in (400, 404, 500)


@pytest.mark.parametrize(
    "message",
    [b"", b"\xc1", b"\xff" * 100, b"\x93\x01\x02\x03", b"\x81\xa4type\xa4Nope", "text",
     b"\xdd\xff\xff\xff\xff", b"\x81\xa4type\xb0GuiUpdateMessage"],
)  # fmt: skip
def test_an_invalid_message_closes_its_connection_silently(port, message, caplog, capfd):
    caplog.set_level("WARNING")
    with client(port) as connection:
        connection.send(message)
        with pytest.raises(ConnectionClosed):
            while True:
                connection.recv(timeout=10)
    assert not [record for record in caplog.records if record.exc_info]
    assert "Traceback" not in "".join(capfd.readouterr())
    with client(port) as connection:
        assert connection.recv(timeout=10)


def test_a_huge_message_closes_its_connection(port):
    with client(port) as connection:
        with pytest.raises(ConnectionClosed) as closed:
            connection.send(bytes(2 << 20))
            while True:
                connection.recv(timeout=10)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009


def test_bytes_that_are_no_request(port, caplog, capfd):
    for data in (b"\x16\x03\x01\x02\x00", b"GET / HTTP/9\r\n\r\n", b"A" * 100_000):
        with socket.create_connection(("127.0.0.1", port), timeout=10) as raw:
            with suppress(OSError):  # The server has closed the connection.
                raw.sendall(data + b"\r\n\r\n")
                raw.shutdown(socket.SHUT_WR)
                while raw.recv(65536):
                    pass
    assert status_of(port, "/") == 200
    assert "Traceback" not in "".join(capfd.readouterr())

"""Servers answer their own page alone: requests of other pages and by other names are refused."""

import asyncio
import http.client
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import pytest

from renet.errors import RenetError
from renet.server import LOOPBACK, is_trusted, serve_folder, serve_scene

pytestmark = pytest.mark.wall_clock

ORIGINS = ("https://evil.example", "http://evil.example:{port}", "null", "https://{host}")
HOSTS = ("evil.example", "127.0.0.1.evil.example", "evil@127.0.0.1.evil.example", "", "[")
OWN = [
    ({}, 200),
    ({"Origin": "http://{host}"}, 200),
    ({"Host": "localhost:{port}"}, 200),
    ({"Host": "localhost:{port}", "Origin": "http://localhost:{port}"}, 200),
]
HOSTILE = [
    *(({"Origin": origin}, 403) for origin in (*ORIGINS, "http://127.0.0.1:1")),
    ({"Host": "evil.example:{port}", "Origin": "http://evil.example:{port}"}, 403),
    *(({"Host": host}, 403) for host in HOSTS),
]


def get(port: int, path: str = "/", headers: dict[str, str] | None = None) -> tuple[int, bytes]:
    """Status and content of an answer; the Host is the address unless it is given."""
    connection = http.client.HTTPConnection(LOOPBACK, port, timeout=60)
    connection.request("GET", path, headers=filled(headers or {}, port))
    answer = connection.getresponse()
    return answer.status, answer.read()


def filled(headers: dict[str, str], port: int) -> dict[str, str]:
    return {k: v.format(host=f"{LOOPBACK}:{port}", port=port) for k, v in headers.items()}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "page"
    (folder / "sub").mkdir(parents=True)
    (folder / "index.html").write_text("the page")
    (folder / "sub" / "main.mjs").write_text("the module")
    (tmp_path / "secret").write_text("a secret")
    return folder


@pytest.fixture
def page(folder: Path) -> Iterator[int]:
    """The port of a served folder."""
    with serve_folder(folder, 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port
        server.shutdown()


@pytest.fixture(scope="module")
def scene() -> Iterator[int]:
    """The port of a served scene."""
    pytest.importorskip("mjviser")
    server = serve_scene(LOOPBACK, 0)
    yield server.get_port()
    server.stop()


@pytest.mark.parametrize(("headers", "status"), OWN + HOSTILE)
def test_requests_of_other_pages_and_by_other_names_are_refused(page, scene, headers, status):
    for port in (page, scene):
        assert get(port, headers=headers)[0] == status


def test_a_folder_is_served_without_links_lists_and_what_is_outside(folder, page):
    (folder / "link").symlink_to("../secret")
    (folder / "up").symlink_to("..")
    os.mkfifo(folder / "pipe")
    assert get(page) == (200, b"the page")
    assert get(page, "/sub/main.mjs?x=1") == (200, b"the module")
    for path in ("/link", "/up/secret", "/up", "/../secret", "/%2e%2e/secret", "/pipe", "/sub/"):
        status, content = get(page, path)
        assert status == 404, path
        assert b"secret" not in content


def test_a_folder_is_served_on_loopback_alone_and_a_visitor_may_leave_early(folder, capfd):
    (folder / "large").write_bytes(bytes(50_000_000))
    with serve_folder(folder, 0) as server:
        assert server.server_address[0] == LOOPBACK
        with pytest.raises(RenetError, match="cannot serve on port"):
            serve_folder(folder, server.server_port)
        server.daemon_threads = False  # The end waits for them.
        with socket.create_connection(server.server_address[:2]) as visitor:
            visitor.sendall(b"GET /large HTTP/1.0\r\nHost: localhost\r\n\r\n")
            server.handle_request()
    assert capfd.readouterr().err == ""


def connect(port: int, headers: dict[str, str], data: bytes = b"") -> str:
    """Open a websocket as viser's client, send something; why it was closed, "" if it was not."""
    import viser
    from websockets.asyncio.client import connect
    from websockets.exceptions import InvalidStatus

    async def visit() -> str:
        sent = {"Host": f"{LOOPBACK}:{port}", "Origin": None, **filled(headers, port)}
        options = {"subprotocols": [f"viser-v{viser.__version__}"], "max_size": None}
        stream = socket.create_connection((LOOPBACK, port))
        try:
            async with connect(
                f"ws://{sent['Host']}/", origin=sent["Origin"], sock=stream, **options
            ) as client:
                await client.recv()
                if data:
                    await client.send(data)
                    await asyncio.sleep(0.5)
                return ""
        except InvalidStatus as error:
            return str(error.response.status_code)

    return asyncio.run(visit())


@pytest.mark.parametrize(("headers", "status"), [*OWN, *HOSTILE[:-3]])
def test_websockets_of_other_pages_are_refused(scene, headers, status):
    assert connect(scene, headers) == ("" if status == 200 else str(status))


def test_nobody_can_ask_for_a_tunnel(scene, monkeypatch):
    import msgspec
    import viser

    monkeypatch.setattr(viser.ViserServer, "request_share_url", tunnel := Mock())
    request = msgspec.msgpack.encode({"type": "ShareUrlRequest"})
    bare = viser.ViserServer(LOOPBACK, 0)
    try:
        assert connect(bare.get_port(), {"Origin": "https://evil.example"}, request) == ""
        tunnel.assert_called_once()  # viser itself does what anybody asks.
    finally:
        bare.stop()
    assert connect(scene, {}, request) == ""
    tunnel.assert_called_once()


def test_a_viser_that_listens_in_another_way_is_refused(monkeypatch):
    viser = pytest.importorskip("viser")
    monkeypatch.setattr(viser, "ViserServer", Mock())
    with pytest.raises(RenetError, match="cannot guard viser"):
        serve_scene(LOOPBACK, 0)
    viser.ViserServer.return_value.stop.assert_called_once()


def test_a_viewer_for_the_network_is_reached_by_numbers_and_its_own_address():
    assert is_trusted(["10.0.0.7:8080"], ["http://10.0.0.7:8080"], "0.0.0.0")
    assert is_trusted(["robot.local:8080"], ["http://robot.local:8080"], "robot.local")
    assert not is_trusted(["10.0.0.7:8080"], [])
    assert not is_trusted(["evil.example:8080"], [], "0.0.0.0")
    assert not is_trusted(["evil.example"], [], "robot.local")
    assert not is_trusted(["localhost", "localhost"], [])
    assert not is_trusted(["localhost"], ["http://localhost", "http://localhost"])
    assert not is_trusted([], [])

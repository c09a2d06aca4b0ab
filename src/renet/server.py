"""The servers that renet starts: on this computer, for its own pages, without links or tunnels.

A web page from anywhere may send requests to a server on loopback. What it cannot choose is the
request's Origin, and what it reaches by a name of its own (DNS rebinding) has that name as Host.
"""

from __future__ import annotations

import ipaddress
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from renet.errors import RenetError, reason

if TYPE_CHECKING:
    import viser

LOOPBACK = "127.0.0.1"


def is_trusted(hosts: list[str], origins: list[str], address: str = LOOPBACK) -> bool:
    """Whether a request comes from nobody's page or from one that the same server served.

    Args:
        hosts: its Host headers. origins: its Origin headers. address: at which the server listens.
    """
    if len(hosts) != 1:
        return False
    try:
        name = urlsplit(f"//{hosts[0]}").hostname or ""
        if name not in ("localhost", address):
            number = ipaddress.ip_address(name)  # Which no name server can point elsewhere.
            if not (number.is_loopback or ipaddress.ip_address(address).is_unspecified):
                return False
    except ValueError:
        return False
    return origins in ([], [f"http://{hosts[0]}"])


def serve_folder(folder: Path, port: int) -> ThreadingHTTPServer:
    """A server of a folder's files on loopback, at any free port for 0.

    Raises:
        RenetError: the port is taken.
    """
    try:
        return ThreadingHTTPServer((LOOPBACK, port), partial(FolderHandler, directory=str(folder)))
    except (OSError, OverflowError) as error:
        raise RenetError(f"cannot serve on port {port}: {reason(error)}") from error


class FolderHandler(SimpleHTTPRequestHandler):
    """Serves regular files with the types that browsers ask of modules and WebAssembly."""

    extensions_map = {  # noqa: RUF012
        **SimpleHTTPRequestHandler.extensions_map,
        ".js": "text/javascript",
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
    }

    def send_head(self) -> Any:
        """Refuse requests of other pages, links, and what is no regular file."""
        hosts, origins = (self.headers.get_all(name, []) for name in ("Host", "Origin"))
        if not is_trusted(hosts, origins):
            return self.send_error(HTTPStatus.FORBIDDEN)
        root, path = Path(self.directory), Path(self.translate_path(self.path))
        path = path / "index.html" if path.is_dir() else path
        if not path.is_file() or path.resolve() != root.resolve() / path.relative_to(root):
            return self.send_error(HTTPStatus.NOT_FOUND)
        return super().send_head()

    def handle(self) -> None:
        """Serve; a visitor who leaves before a file has arrived is no error."""
        with suppress(ConnectionError):
            super().handle()

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


def serve_scene(address: str, port: int = 8080) -> viser.ViserServer:
    """A viser server that answers its own page alone and opens no tunnel to the internet.

    Args:
        address: of this computer, at which it listens. port: the first to try; 0 is any free one.

    Raises:
        RenetError: mjviser is not installed, or its viser does not listen as this one knows.
    """
    try:
        import mjviser  # noqa: F401
        import viser
        from viser import _messages
        from websockets.asyncio import server as websockets
    except ModuleNotFoundError as error:
        raise RenetError(f"--viewer needs {error.name}: pip install mjviser") from error
    real, guards = websockets.serve, []

    def serve(*arguments: Any, process_request: Any, **options: Any) -> Any:
        def guard(connection: Any, request: Any) -> Any:
            hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
            if is_trusted(hosts, origins, address):
                return process_request(connection, request)
            return connection.respond(HTTPStatus.FORBIDDEN, "")

        guards.append(guard)
        return real(*arguments, process_request=guard, **options)

    websockets.serve = serve  # viser has no other way to see a request before it is answered.
    try:
        server = viser.ViserServer(address, port)
    finally:
        websockets.serve = real
    if not guards:
        server.stop()
        raise RenetError(f"--viewer cannot guard viser {viser.__version__}: install viser 1.1.1")
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)
    server.gui.configure_theme(show_share_button=False)
    return server

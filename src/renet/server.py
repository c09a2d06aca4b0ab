"""Servers for this computer's own pages, without symbolic links and tunnels.

Any web page in a browser may send requests to a server on loopback. The page cannot choose the
request's Origin, and if it reaches the server by a name of its own (DNS rebinding), the request has
that name as its Host.
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
    """Return True for a request from no page, or from a page of the same server.

    Args:
        hosts: Host headers of the request.
        origins: Origin headers of the request.
        address: Address at which the server listens.
    """
    if len(hosts) != 1:
        return False
    try:
        name = urlsplit(f"//{hosts[0]}").hostname or ""
        if name not in ("localhost", address):
            # A number, unlike a name, cannot be pointed elsewhere by a name server.
            number = ipaddress.ip_address(name)
            if not (number.is_loopback or ipaddress.ip_address(address).is_unspecified):
                return False
    except ValueError:
        return False
    return origins in ([], [f"http://{hosts[0]}"])


def serve_folder(folder: Path, port: int) -> ThreadingHTTPServer:
    """Build a server of a folder's files on loopback.

    Args:
        folder: The folder.
        port: Port; 0 for any free one.

    Raises:
        RenetError: The port is taken.
    """
    try:
        return ThreadingHTTPServer((LOOPBACK, port), partial(FolderHandler, directory=str(folder)))
    except (OSError, OverflowError) as error:
        why = reason(error).rstrip(".")
        raise RenetError(
            f"cannot serve on port {port}: {why}; give another --port, or 0 for any free one"
        ) from error


class FolderHandler(SimpleHTTPRequestHandler):
    """Handler of regular files, with the types that browsers require of modules and WebAssembly."""

    extensions_map = {  # noqa: RUF012
        **SimpleHTTPRequestHandler.extensions_map,
        ".js": "text/javascript",
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
    }

    def send_head(self) -> Any:
        """Refuse requests from other pages, and for anything but regular files."""
        hosts, origins = (self.headers.get_all(name, []) for name in ("Host", "Origin"))
        if not is_trusted(hosts, origins):
            return self.send_error(HTTPStatus.FORBIDDEN)
        root = Path(self.directory)
        path = Path(self.translate_path(self.path))
        if path.is_dir():
            path = path / "index.html"
        # A link below the folder resolves to another path.
        if not path.is_file() or path.resolve() != root.resolve() / path.relative_to(root):
            return self.send_error(HTTPStatus.NOT_FOUND)
        return super().send_head()

    def handle(self) -> None:
        """Serve a connection; it is no error if a visitor leaves before a file has arrived."""
        with suppress(ConnectionError):
            super().handle()

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


def serve_scene(address: str, port: int = 8080) -> viser.ViserServer:
    """Build a viser server that answers its own page alone and opens no tunnel to the internet.

    Args:
        address: Address of this computer at which it listens.
        port: First port to try; 0 for any free one.

    Raises:
        RenetError: mjviser is not installed, or this version of viser cannot be guarded.
    """
    try:
        import mjviser  # noqa: F401
        import viser
        from viser import _messages
        from websockets.asyncio import server as websockets
    except ModuleNotFoundError as error:
        raise RenetError(f"--viewer needs {error.name}: pip install mjviser") from error
    real = websockets.serve
    guards = []

    def serve(*arguments: Any, process_request: Any, **options: Any) -> Any:
        def guard(connection: Any, request: Any) -> Any:
            hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
            if is_trusted(hosts, origins, address):
                return process_request(connection, request)
            return connection.respond(HTTPStatus.FORBIDDEN, "")

        guards.append(guard)
        return real(*arguments, process_request=guard, **options)

    # viser has no other way to see a request before it is answered.
    websockets.serve = serve
    try:
        server = viser.ViserServer(address, port)
    finally:
        websockets.serve = real
    # A version of viser that serves in another way has not called `serve`.
    if not guards:
        server.stop()
        raise RenetError(f"--viewer cannot guard viser {viser.__version__}: install viser 1.1.1")
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)
    server.gui.configure_theme(show_share_button=False)
    return server

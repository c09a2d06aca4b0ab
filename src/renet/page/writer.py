"""`renet page`: the page "Break its camera" for any bundle, as one folder of static files."""

from __future__ import annotations

import json
import shutil
import webbrowser
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import tyro

from renet.bundle import MANIFEST, Bundle
from renet.bundle.models import MODELS
from renet.errors import RenetError
from renet.page.contract import contract

FOLDERS = (Path(__file__).with_name("web"), Path(__file__).parents[3] / "web")
WEB = next((folder for folder in FOLDERS if (folder / "index.html").is_file()), FOLDERS[0])
"""The page's own files and npm packages: in an installed wheel, or at the root of a clone."""
MARK = "renet-page.json"
"""A folder with this file is a page, and may be written anew."""
VENDOR = (
    "@mujoco/mujoco/mujoco.js",
    "@mujoco/mujoco/mujoco.wasm",
    "onnxruntime-web/dist/ort.wasm.min.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.wasm",
    "three/build/three.core.js",
    "three/build/three.module.js",
)
"""Files of the npm packages that a visitor's browser loads."""
LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class PageCfg:
    """Write the page "Break its camera": a bundle walks in the browser, and its camera fails."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder; the one that ships with renet by default."""
    out: Path = Path("renet-page")
    """Folder to write; must be empty, absent, or an earlier page."""
    runtime: Path = WEB / "node_modules"
    """Folder of the npm packages of the page's package.json."""
    open: bool = False
    """Serve the folder on this machine alone and open it in the browser, until Ctrl-C."""
    port: int = 0
    """Port to serve on; 0: any that is free."""


def run_page(cfg: PageCfg) -> Path:
    """Write the page, and serve it if asked to; returns its folder.

    Raises:
        RenetError: a bad bundle, a folder that holds something else, missing npm packages, or a
            port that is taken.
    """
    folder = write_page(cfg)
    if cfg.open:
        with make_server(folder, cfg.port) as server:
            address = f"http://{LOOPBACK}:{server.server_port}/"
            print(f"{address} (Ctrl-C ends it)", flush=True)
            webbrowser.open(address)
            server.serve_forever()
    return folder


def write_page(cfg: PageCfg) -> Path:
    """Write the folder beside its final place and rename it: nobody sees half of one.

    Raises:
        RenetError: a bad bundle, a folder that holds something else, or missing npm packages.
    """
    out = cfg.out.resolve()
    is_page = (out / MARK).is_file() and not (out / ".git").exists()
    if out.exists() and not is_page and (out.is_file() or any(out.iterdir())):
        raise RenetError(f"{cfg.out} exists and is not a page: choose another folder")
    vendor = [cfg.runtime / name for name in VENDOR]
    missing = next((path for path in vendor if not path.is_file()), None)
    if missing is not None:
        raise RenetError(
            f"{missing} is missing: run `npm ci --prefix {WEB}`, or give the folder of the npm "
            "packages with --runtime"
        )
    bundle = Bundle.load(cfg.bundle)
    partial_folder = out.with_name(f".{out.name}.partial")
    try:
        shutil.rmtree(partial_folder, ignore_errors=True)
        _fill(partial_folder, bundle, vendor)
        shutil.rmtree(out, ignore_errors=True)
        partial_folder.rename(out)
    except OSError as error:
        raise RenetError(f"cannot write the page {cfg.out}: {error}") from error
    return cfg.out


def _fill(folder: Path, bundle: Bundle, vendor: list[Path]) -> None:
    packages = shutil.ignore_patterns("node_modules", "package*.json", ".*")
    shutil.copytree(WEB, folder, ignore=packages)
    for sub in ("vendor", "bundle"):
        (folder / sub).mkdir()
    for path in vendor:
        shutil.copyfile(path, folder / "vendor" / path.name)
    for name in (MANIFEST, *(f"{model}.onnx" for model in MODELS)):
        shutil.copyfile(bundle.path / name, folder / "bundle" / name)
    (folder / MARK).write_text(json.dumps({**contract(), "bundle": bundle.name}))


def make_server(folder: Path, port: int) -> ThreadingHTTPServer:
    """A server of a page on loopback, at any free port for 0; raises RenetError for one taken."""
    try:
        return ThreadingHTTPServer((LOOPBACK, port), partial(QuietHandler, directory=str(folder)))
    except (OSError, OverflowError) as error:
        raise RenetError(f"cannot serve on port {port}: {error}") from error


class QuietHandler(SimpleHTTPRequestHandler):
    """Serves files with the types that browsers ask of modules and WebAssembly."""

    extensions_map = {  # noqa: RUF012
        **SimpleHTTPRequestHandler.extensions_map,
        ".js": "text/javascript",
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
    }

    def handle(self) -> None:
        """Serve; a visitor who leaves before a file has arrived is no error."""
        with suppress(ConnectionError):
            super().handle()

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""

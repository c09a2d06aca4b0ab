"""`renet page`: the page "Break its camera" for any bundle, as one folder of static files."""

from __future__ import annotations

import json
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import tyro

from renet.bundle import MANIFEST, SHIPPED, Bundle, pretrained
from renet.bundle.models import MAX_MODEL_BYTES, MODELS
from renet.errors import RenetError
from renet.files import MEGABYTE, read_bytes, read_object
from renet.folders import demand_own, write_folder
from renet.page.contract import contract
from renet.server import LOOPBACK, serve_folder

FOLDERS = (Path(__file__).with_name("web"), Path(__file__).parents[3] / "web")
WEB = next((folder for folder in FOLDERS if (folder / "index.html").is_file()), FOLDERS[0])
"""The page's own files and npm packages: in an installed wheel, or at the root of a clone."""
MARK = "renet-page.json"
"""Lists the files of a page, which may be written anew, and their digests."""
MAX_FILE = 100 * MEGABYTE
"""Bytes of a page's file."""
VENDOR = (
    "@mujoco/mujoco/mujoco.js",
    "@mujoco/mujoco/mujoco.wasm",
    "onnxruntime-web/dist/ort.wasm.min.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.wasm",
    "three/build/three.core.js",
    "three/build/three.module.js",
    "three/examples/jsm/controls/OrbitControls.js",
    "three/examples/jsm/loaders/GLTFLoader.js",
    "three/examples/jsm/utils/BufferGeometryUtils.js",
    "three/examples/jsm/utils/SkeletonUtils.js",
    "uplot/dist/uPlot.esm.js",
    "uplot/dist/uPlot.min.css",
)
"""Files of the npm packages that a visitor's browser loads."""


def look_name(robot: str) -> str:
    """File of a robot's look in `web/`, by the name that bundles give the robot."""
    return f"robots/{robot.lower().replace(' ', '-')}.glb"


@dataclass(frozen=True)
class PageCfg:
    """Write the page "Break its camera": a bundle walks in the browser, and its camera fails."""

    bundles: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Bundle folders, among which visitors choose; by default those that ship with renet."""
    out: Path = Path("renet-page")
    """Folder to write; must be empty, absent, or an earlier page as it was written."""
    runtime: Path = WEB / "node_modules"
    """Folder of the npm packages of the page's package.json."""
    open: bool = False
    """Serve the folder on this machine alone and open it in the browser, until Ctrl-C."""
    port: int = 0
    """Port to serve on; 0: any that is free."""


def run_page(cfg: PageCfg) -> Path:
    """Write the page, and serve it if asked to; returns its folder.

    Raises:
        RenetError: what `write_page` raises, or a port that is taken.
    """
    folder = write_page(cfg)
    if cfg.open:
        with serve_folder(folder, cfg.port) as server:
            address = f"http://{LOOPBACK}:{server.server_port}/"
            print(f"{address} (Ctrl-C ends it)", flush=True)
            webbrowser.open(address)
            server.serve_forever()
    return folder


def write_page(cfg: PageCfg) -> Path:
    """Write the folder whole, in place of an earlier page that nobody changed.

    Raises:
        RenetError: a bad bundle, two of one name, a folder of something else, no npm packages.
    """
    vendor = [cfg.runtime / name for name in VENDOR]
    missing = next((path for path in vendor if not path.is_file()), None)
    if missing is not None:
        raise RenetError(
            f"{missing} is missing: run `npm ci --prefix {WEB}`, or give the folder of the npm "
            "packages with --runtime"
        )
    earlier = _earlier(cfg.out)
    demand_own(cfg.out, earlier, "page")
    bundles = [Bundle.load(path) for path in cfg.bundles or map(pretrained, SHIPPED)]
    if len({(bundle.manifest.robot.name, bundle.name) for bundle in bundles}) < len(bundles):
        raise RenetError("visitors choose between a robot's bundles by name: rename one of two")
    contents = _contents(bundles, cfg.runtime)
    write_folder(cfg.out, contents, earlier, "page")
    return cfg.out


def _contents(bundles: Sequence[Bundle], runtime: Path) -> dict[str, bytes]:
    """Every file of a page by its name, the mark with the digests of all others among them."""
    contents = {}
    for top in WEB.iterdir():
        if top.name.startswith(("node_modules", "package", ".")):
            continue
        for path in (top, *top.rglob("*")):
            if path.is_file():
                contents[path.relative_to(WEB).as_posix()] = path.read_bytes()
    for name in VENDOR:
        contents[f"vendor/{name}"] = (runtime / name).read_bytes()
    mark = contract(bundles)
    for number, (bundle, entry) in enumerate(zip(bundles, mark["bundles"], strict=True)):
        folder = f"bundles/{number}"
        look = look_name(entry["robot"])
        entry["folder"] = folder
        entry["look"] = look if look in contents else None
        for name in (MANIFEST, *(f"{model}.onnx" for model in MODELS)):
            file = read_bytes(bundle.path / name, MAX_MODEL_BYTES, "bundle's file")
            contents[f"{folder}/{name}"] = file
    mark["sizes"] = {name: len(data) for name, data in contents.items()}
    digests = {name: sha256(data).hexdigest() for name, data in contents.items()}
    return contents | {MARK: json.dumps({**mark, "files": digests}).encode()}


def _earlier(folder: Path) -> set[str]:
    """Files of an earlier page that are still as they were written, by its mark."""
    if not (folder / MARK).is_file():
        return set()
    digests = read_object(folder / MARK, "page's mark").get("files")
    if not isinstance(digests, dict):
        return {MARK}
    earlier = {MARK}
    for name, digest in digests.items():
        path = folder / name
        # A damaged mark must not lead out of the folder.
        if ".." in name.split("/") or not path.is_file():
            continue
        if sha256(read_bytes(path, MAX_FILE, "page's file")).hexdigest() == digest:
            earlier.add(name)
    return earlier

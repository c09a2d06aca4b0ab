import json
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from renet.bundle import pretrained, read_manifest, write_bundle, write_manifest
from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.page.writer import WEB, PageCfg, write_page
from renet.server import serve_folder
from renet.training.export import export_models
from tests.browser import open_browser
from tests.page.visit import DESKTOP, Visit


def run_node(script: str, *arguments: object):
    """What a script of this folder prints, read as JSON."""
    # WebAssembly does not run for long enough here to be worth optimising.
    node = ["node", "--liftoff-only", str(Path(__file__).with_name(script))]
    command = [*node, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300.0)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="session")
def page(tmp_path_factory) -> Path:
    """The page of the bundles that ship."""
    if not (WEB / "node_modules" / "three").is_dir():
        pytest.skip(f"the page's npm packages are missing: npm ci --prefix {WEB}")
    return write_page(PageCfg(out=tmp_path_factory.mktemp("page") / "page"))


@pytest.fixture(scope="session")
def node_page(page: Path) -> Path:
    """The same, where there is a Node.js to run its modules."""
    if shutil.which("node") is None:
        pytest.skip("no Node.js on this machine")
    return page


@pytest.fixture(scope="session")
def memory_page(node_page: Path, tmp_path_factory) -> Path:
    """The page of the shipped bundle, whose VP may drive for 1.5 s without an image."""
    folder = tmp_path_factory.mktemp("memory")
    path = shutil.copytree(pretrained("go1-parkour"), folder / "b")
    manifest = read_manifest(path)
    write_manifest(path, replace(manifest, selector=replace(manifest.selector, longest_memory=1.5)))
    return write_page(PageCfg((path,), folder / "page"))


@pytest.fixture(scope="session")
def driven_page(node_page: Path, tmp_path_factory) -> Path:
    """The page of the bundle that is told twists."""
    folder = tmp_path_factory.mktemp("driven")
    return write_page(PageCfg((pretrained("go1-driven"),), folder / "page"))


@pytest.fixture(scope="session")
def surprised_page(node_page: Path, tmp_path_factory) -> Path:
    """The page of the bundle that expects images, to which only surprising ones are odd."""
    folder = tmp_path_factory.mktemp("surprised")
    path = shutil.copytree(pretrained("go1-driven"), folder / "b")
    manifest = read_manifest(path)
    thresholds = {"surprise": 0.3, "variance": 99.0, "reconstruction": 0.25}
    selector = replace(manifest.selector, thresholds=thresholds)
    write_manifest(path, replace(manifest, selector=selector))
    return write_page(PageCfg((path,), folder / "page"))


@pytest.fixture(scope="session")
def still_page(node_page: Path, tmp_path_factory) -> Path:
    """The page of untrained networks whose vision model finds images that stand still."""
    torch.manual_seed(0)
    cfg = ModelCfg(detector="variance", expect_image=True)
    models = export_models(RENet(cfg, critic_size=10))
    manifest = read_manifest(pretrained("go1-driven"))
    thresholds = {"stillness": 0.5, "variance": 99.0, "reconstruction": 0.25}
    selector = replace(manifest.selector, thresholds=thresholds)
    folder = tmp_path_factory.mktemp("still")
    path = write_bundle(folder / "b", models, replace(manifest, selector=selector))
    return write_page(PageCfg((path,), folder / "page"))


@pytest.fixture(scope="session")
def address(page: Path) -> Iterator[str]:
    """Where the page is served."""
    with serve_folder(page, 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.fixture(scope="module")
def browser():
    with open_browser() as browser:
        yield browser


@contextmanager
def visiting(browser, address: str) -> Iterator[Callable[..., Visit]]:
    """Makes visits, each in a window of its own, and ends them without a complaint."""
    visits: list[Visit] = []

    def make(query: str = "", size: dict[str, int] = DESKTOP, scheme: str = "light") -> Visit:
        context = browser.new_context(viewport=size, has_touch=True, color_scheme=scheme)
        visits.append(Visit(context.new_page(), address + query))
        return visits[-1]

    yield make
    for one in visits:
        one.page.context.close()
        assert one.complaints == []


@pytest.fixture
def visit(browser, address):
    with visiting(browser, address) as make:
        yield make

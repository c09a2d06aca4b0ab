"""`renet page` writes one folder, for any bundle, and nothing over what is not a page."""

import gzip
import json
import re
import shutil
import tomllib
import urllib.request
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import mujoco
import pytest

from renet import cli
from renet.bundle import Bundle, pretrained, read_manifest, write_manifest
from renet.deploy.robots.sim.scene import build_scene
from renet.errors import RenetError
from renet.files import MEGABYTE
from renet.interface import TRUNK
from renet.page.contract import GROUNDS, contract
from renet.page.writer import MARK, VENDOR, WEB, PageCfg, write_page
from renet.robots import GO1, GO2
from renet.sim.sensors import HeightMapCfg
from renet.terrain.tiles import find_tile

SHIPPED = pretrained("go1-parkour")


def with_selector(manifest, **changes):
    return replace(manifest, selector=replace(manifest.selector, **changes))


def contents(folder: Path) -> dict[Path, bytes | None]:
    """Everything below a folder: bytes of files, None for folders."""
    return {p: p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


@pytest.fixture
def cfg(tmp_path) -> PageCfg:
    """Settings of a page with a small file for each of the npm packages'."""
    cfg = PageCfg(out=tmp_path / "page", runtime=tmp_path / "packages")
    for name in VENDOR:
        (cfg.runtime / name).parent.mkdir(parents=True, exist_ok=True)
        (cfg.runtime / name).write_text(name)
    return cfg


def test_page_has_the_bundle_the_packages_and_the_modules(tmp_path, cfg):
    bundle = Path(shutil.copytree(SHIPPED, tmp_path / "mine"))
    write_manifest(bundle, with_selector(read_manifest(bundle), calibration="mine"))
    page = write_page(replace(cfg, bundles=(bundle, SHIPPED)))
    mark = json.loads((page / MARK).read_text())
    assert [entry["name"] for entry in mark["bundles"]] == ["mine", "go1-parkour"]
    assert [entry["look"] for entry in mark["bundles"]] == ["robots/unitree-go1.glb"] * 2
    assert read_manifest(page / mark["bundles"][0]["folder"]).selector.calibration == "mine"
    for name in VENDOR:
        assert (page / "vendor" / name).read_text() == name
    folders = ("control", "panel", "stage", "world", ".")
    scripts = [path for folder in folders for path in (WEB / folder).glob("*.js")]
    assert len(scripts) > 15
    for path in [*scripts, WEB / "index.html", WEB / "style.css"]:
        assert (page / path.relative_to(WEB)).read_bytes() == path.read_bytes()
    for name, size in mark["sizes"].items():
        assert (page / name).stat().st_size == size
    assert not list(page.glob("*package*.json"))


def test_page_may_be_written_again_without_what_it_held_before(tmp_path, cfg):
    write_page(cfg)
    mark = json.loads((cfg.out / MARK).read_text())
    (cfg.out / "old.js").write_text("old")
    mark["files"]["old.js"] = sha256(b"old").hexdigest()
    (cfg.out / MARK).write_text(json.dumps(mark))
    write_page(cfg)
    assert not (cfg.out / "old.js").exists()
    assert {path.name for path in tmp_path.iterdir()} == {"packages", "page"}


@pytest.mark.parametrize("name", ["CNAME", ".git/config", "bundles/thesis.tex", "index.html"])
def test_page_that_holds_what_is_not_its_own_stays_as_it_is(tmp_path, cfg, name):
    """Another file, or one of its own that somebody changed, be the mark forged or not."""
    write_page(cfg)
    path = cfg.out / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("years of work")
    forged = {"files": {"../victim": "", name: "0" * 64, "..": "", "/": ""}}
    (tmp_path / "victim").write_text("years of work")
    for mark in ((cfg.out / MARK).read_text(), json.dumps(forged), '{"files": [1]}'):
        (cfg.out / MARK).write_text(mark)
        before = contents(tmp_path)
        with pytest.raises(RenetError, match="no part of a page"):
            write_page(cfg)
        assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("bundles", "out", "message"),
    [
        ((), "thesis", "part of a page"),
        ((), "thesis/chapter.tex", "is not a page"),
        (("nowhere",), "page", "no bundle"),
        (("go1-parkour", SHIPPED), "page", "rename one of two"),
    ],
)
def test_what_is_refused_leaves_everything_as_it_was(tmp_path, cfg, bundles, out, message):
    """A folder without a mark, a file, a bundle that is none, and two of one name."""
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    shutil.copytree(SHIPPED, tmp_path / "go1-parkour")
    write_page(cfg)
    before = contents(tmp_path)
    paths = tuple(tmp_path / path for path in bundles)
    with pytest.raises(RenetError, match=message):
        write_page(replace(cfg, bundles=paths, out=tmp_path / out))
    assert contents(tmp_path) == before


def test_wheel_takes_along_what_the_page_needs():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    artifacts = [f"web/node_modules/{name}" for name in VENDOR]
    assert project["tool"]["hatch"]["build"]["artifacts"] == artifacts


@pytest.mark.parametrize("missing", VENDOR)
def test_missing_package_is_one_line_that_says_what_to_run(capsys, cfg, missing):
    (cfg.runtime / missing).unlink()
    assert cli.main(["page", "--out", str(cfg.out), "--runtime", str(cfg.runtime)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(f"{Path(missing).name}.*npm ci --prefix", line)
    assert not cfg.out.exists()


@pytest.fixture(scope="module")
def shared() -> dict:
    """The contract of both robots, as JSON."""
    both = contract([Bundle.load(), Bundle.load("go2-parkour")])
    return json.loads(json.dumps(both, allow_nan=False))


ENDS = {"gap": (1.2, 1.7), "stairs_down": (1.5, 3.9), "stairs_up": (1.2, 3.6)}
ENDS |= {"platform": (1.4, 2.8), "flat": None}


@pytest.mark.parametrize("number", [0, 1], ids=["go1", "go2"])
@pytest.mark.parametrize("terrain", GROUNDS)
def test_grounds_are_the_runtimes_and_obstacles_end_where_tiles_say(terrain, number, shared):
    bundle, robot = shared["bundles"][number], (GO1, GO2)[number]
    ground = next(g for g in bundle["grounds"] if g["name"] == terrain)
    mine = mujoco.MjModel.from_xml_string(ground["xml"])
    its, start = build_scene(terrain, GROUNDS[terrain][1], robot=robot)
    assert bundle["base"] == {"body": TRUNK, "height": robot.height}
    assert shared["heightMap"]["baseHeight"] == HeightMapCfg("map").base_height, "as in training"
    assert ground["start"] == start
    for name in ("geom_pos", "geom_size", "geom_group", "body_mass", "actuator_gainprm"):
        assert getattr(mine, name) == pytest.approx(getattr(its, name), rel=1e-5, abs=1e-5), name
    for name in ("timestep", "integrator"):
        assert getattr(mine.opt, name) == getattr(its.opt, name)
    assert ground["obstacle"] == (pytest.approx(ENDS[terrain], abs=0.02) if ENDS[terrain] else None)
    if terrain != "flat":
        # The score of a recording takes it from the tile.
        tile = find_tile(terrain, GROUNDS[terrain][1])
        end = tile.obstacle_end(tile.measure_at(GROUNDS[terrain][1]))
        assert ground["obstacle"][1] == pytest.approx(end, abs=0.02)


def test_opening_scene_is_one_that_the_bundle_can_walk():
    bundle = Bundle.load()
    without = {"ground": "stairs_down", "fault": "blackout", "left": "camera", "right": "memory"}
    with_one = {"ground": "gap", "fault": "gaussian", "left": "switch", "right": "memory"}
    for memory, opening in ((0.0, without), (1.5, with_one)):
        manifest = with_selector(bundle.manifest, longest_memory=memory)
        (entry,) = contract([replace(bundle, manifest=manifest)])["bundles"]
        assert entry["opening"] == opening
        assert entry["selectors"]["memory"]["longestMemory"] == memory
        assert entry["selectors"]["switch"]["longestMemory"] == 0.0


def test_bundles_are_called_by_their_robot_and_by_name_among_several():
    go1 = Bundle.load()
    other = replace(go1, path=Path("mine"))
    (alone, go2) = contract([go1, Bundle.load("go2-parkour")])["bundles"]
    assert (alone["title"], go2["title"]) == ("Go1", "Go2")
    titles = [one["title"] for one in contract([go1, other])["bundles"]]
    assert titles == ["Go1 · parkour", "Go1 · mine"]


def test_download_of_a_visit_is_small(page):
    """A visit loads the models of one bundle."""
    sizes = {}
    for path in page.rglob("*"):
        if path.is_file():
            sizes[path.relative_to(page).as_posix()] = len(gzip.compress(path.read_bytes()))
    bundles = sum(size for name, size in sizes.items() if name.startswith("bundles/"))
    for entry in json.loads((page / MARK).read_text())["bundles"]:
        own = sum(size for name, size in sizes.items() if name.startswith(entry["folder"] + "/"))
        assert sum(sizes.values()) - bundles + own < 10 * MEGABYTE, entry["name"]


def test_files_arrive_with_types_that_browsers_ask_for(address):
    types = {
        "main.js": "text/javascript",
        "vendor/onnxruntime-web/dist/ort.wasm.min.mjs": "text/javascript",
        "vendor/@mujoco/mujoco/mujoco.wasm": "application/wasm",
    }
    for name, kind in types.items():
        with urllib.request.urlopen(address + name) as answer:
            assert answer.headers["Content-Type"] == kind
            assert answer.read() == (WEB / name.replace("vendor", "node_modules")).read_bytes()
